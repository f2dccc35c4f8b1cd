"""Cameras that answer but send nothing while another one sends: reopening them revives a stalled stream."""

from __future__ import annotations

from collections.abc import Collection

from autoexpose_daemon.status.telemetry import GONE, Telemetry
from drivers.frames import Side

FIRST_PAUSE_NS = 3_000_000_000
LONGEST_PAUSE_NS = 600_000_000_000
"""How long a camera is silent before the first attempt; the pause doubles each time, since reopening does not help if
its trigger wire is cut."""

FLOWING_NS = 500_000_000
PERIODS = 10.0
"""At low rates: another camera has sent a frame within this many periods, and this one has missed more."""


class StuckStreams:
    """Decides when to reopen a camera; for one thread.

    Parameters
    ----------
    period_s
        Between two triggers.
    """

    def __init__(self, period_s: float) -> None:
        self._periods_ns = PERIODS * period_s * 1e9
        self._due_ns: dict[Side, float] = {}
        self._pause_ns: dict[Side, float] = {}

    def sides(self, telemetry: Telemetry, now_ns: int, untriggered: Collection[Side] = ()) -> list[Side]:
        """The cameras to reopen now; those that are not triggered yet cannot be stuck."""
        flowing_ns = max(FLOWING_NS, self._periods_ns)
        flowing = {side for side, last_ns in telemetry.last_frame_ns.items() if now_ns - last_ns < flowing_ns}
        stuck = []
        for side, camera in telemetry.cameras.items():
            if side in flowing:
                self._pause_ns.pop(side, None)
            if side in flowing or not flowing or camera == GONE or side in untriggered:
                self._due_ns.pop(side, None)
                continue
            pause_ns = self._pause_ns.setdefault(side, max(FIRST_PAUSE_NS, 2 * self._periods_ns))
            if now_ns >= self._due_ns.setdefault(side, now_ns + pause_ns):
                stuck.append(side)
                del self._due_ns[side]
                self._pause_ns[side] = min(2 * pause_ns, LONGEST_PAUSE_NS)
        return stuck
