"""Cameras that answer but send nothing although they should: reopening them revives a stalled stream."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from autoexpose_daemon.status.telemetry import GONE
from imaging.frames import Side

FIRST_PAUSE_NS = 3_000_000_000
LONGEST_PAUSE_NS = 600_000_000_000
"""How long a camera is silent before the first attempt; the pause doubles each time, since reopening does not help if
its trigger wire is cut."""

FLOWING_NS = 500_000_000
PERIODS = 10.0
"""At low rates: another camera has sent a frame within this many periods, and this one has missed more."""

BESIDE_ANOTHER = "sends no frames while the other one does"
LIKE_ALL = "sends no frames"


class StuckStreams:
    """Decides when to reopen a camera; for one thread.

    Parameters
    ----------
    period_s
        Between two triggers.
    needs_pulses
        Whether triggers come from elsewhere: if no camera sends anything, they may have stopped.
    """

    def __init__(self, period_s: float, *, needs_pulses: bool) -> None:
        self._periods_ns, self._needs_pulses = PERIODS * period_s * 1e9, needs_pulses
        self._arrived_ns: dict[Side, int] = {}
        self._due_ns: dict[Side, float] = {}
        self._pause_ns: dict[Side, float] = {}

    def arrived(self, side: Side, now_ns: int) -> None:
        """A frame has arrived, complete or not."""
        self._arrived_ns[side] = now_ns

    def reasons(self, cameras: Mapping[Side, str], now_ns: int, untriggered: Collection[Side] = ()) -> dict[Side, str]:
        """Which cameras to reopen now, and why; those that are not triggered yet cannot be stuck."""
        flowing_ns = max(FLOWING_NS, self._periods_ns)
        flowing = {side for side, last_ns in self._arrived_ns.items() if now_ns - last_ns < flowing_ns}
        stuck: dict[Side, str] = {}
        for side, camera in cameras.items():
            if side in flowing:
                self._pause_ns.pop(side, None)
            stopped = self._needs_pulses and not flowing
            if side in flowing or stopped or camera == GONE or side in untriggered:
                self._due_ns.pop(side, None)
                continue
            pause_ns = self._pause_ns.setdefault(side, max(FIRST_PAUSE_NS, 2 * self._periods_ns))
            if now_ns >= self._due_ns.setdefault(side, now_ns + pause_ns):
                stuck[side] = BESIDE_ANOTHER if flowing else LIKE_ALL
                del self._due_ns[side]
                self._pause_ns[side] = min(2 * pause_ns, LONGEST_PAUSE_NS)
        return stuck
