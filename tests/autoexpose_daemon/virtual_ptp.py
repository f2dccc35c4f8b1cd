"""A daemon on two virtual cameras with drifting clocks and a PTP master, seen from a test."""

from __future__ import annotations

from collections import Counter

from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.status.states import Health
from drivers.triggers.outcomes import LossReason
from tests.autoexpose_daemon.virtual import START_US, tuning
from tests.soak.camera import VirtualFrame
from tests.soak.clock import MS, SECOND
from tests.soak.ptp import ERROR_NS, Master, PtpDevice
from tests.soak.rig import VirtualRig

EXACT_NS = 3 * ERROR_NS + 100
"""How far apart exposures are while both clocks are synchronised: each by its error, and its drift in half a second."""
HELD_NS = MS
"""And otherwise: by the host's readings of the clocks, once a second."""


class PtpRun:
    """A rig of two cameras with a PTP master, if there is one."""

    def __init__(self, rate_hz: float = 20.0) -> None:
        self.apart_ns: list[int] = []
        self.alone = 0
        self.said: list[str] = []
        self.rate_hz = rate_hz
        self.master = Master()
        self.rig = VirtualRig(
            7,
            self._see_pair,
            self._see_health,
            tuning(START_US, trigger={"mode": "ptp", "rate_hz": rate_hz}),
            new_device=PtpDevice,
        )
        left, right = self.rig.devices
        assert isinstance(left, PtpDevice) and isinstance(right, PtpDevice)
        self.left, self.right = left, right
        for unit in self.rig.units.values():
            assert isinstance(unit.device, PtpDevice)
            unit.device.on_frame = unit.plan_frames
            unit.device.master = self.master
        self.actors = [actor for device in (left, right) for actor in device.actors]

    def let_pass(self, seconds: float) -> None:
        self.rig.run(self.actors, self.rig.clock.now_ns + round(seconds * SECOND))

    def begin(self) -> None:
        """Until pairs have come for a second."""
        self.let_pass(10.0)
        assert len(self.apart_ns) >= self.rate_hz
        assert self.said == ["exposing"]
        self.apart_ns.clear()
        self.said.clear()

    def end(self, most_surplus: int = 0) -> Counter[LossReason]:
        """Why slots made no pair, apart from start and end.

        When a clock is set, actions that wait for their time act at another: these frames are surplus.
        """
        self.rig.control.close()
        tally = self.rig.control.record.tally
        assert tally.surplus_frames <= most_surplus
        lost = +tally.lost
        del lost[LossReason.STARTUP], lost[LossReason.SHUTDOWN]
        return lost

    def _see_pair(self, step: ControlStep) -> None:
        pair = step.pair
        times_ns = [frame.pulse for frame in pair.frames.values() if isinstance(frame, VirtualFrame)]
        if len(times_ns) == 1:
            self.alone += 1
            return
        self.apart_ns.append(abs(times_ns[0] - times_ns[1]))
        assert self.apart_ns[-1] < SECOND / self.rate_hz / 2, "a pair of two instants"

    def _see_health(self, _now_ns: int, health: Health) -> None:
        self.said.append(str(health))

    def hours_with_outages(self, hours: int) -> None:
        """Each hour the cameras are without their master for ten minutes, and all is well at the end of it."""
        for _ in range(hours):
            self.master.on_air = False
            self.let_pass(600.0)
            assert "left camera: its clock is no longer synchronised" in self.said[-1]
            self.master.on_air = True
            self.let_pass(3000.0)
            assert self.said[-1] == "exposing"
        assert abs(len(self.apart_ns) - hours * 3600 * self.rate_hz) < 4 * hours + 20
        further = [apart_ns for apart_ns in self.apart_ns if apart_ns >= HELD_NS]
        assert len(further) <= 4 * hours  # actions that waited while the master came back, and set the clocks
        assert sum(self.end(most_surplus=10 * hours).values()) <= 10 * hours
