"""A daemon's control and supervision on virtual cameras, a virtual trigger wire or a PTP master, seen from a test."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.status.counters import counters
from autoexpose_daemon.status.states import Health
from autoexpose_daemon.status.telemetry import Telemetry
from drivers.triggers.outcomes import LossReason, missing
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, FrameSet
from imaging.geometry import SIDES
from tests.soak.camera import Device, VirtualFrame
from tests.soak.clock import MS, SECOND, Clock
from tests.soak.ptp import ERROR_NS, Master, PtpDevice
from tests.soak.rig import CONFIG, PERIOD_NS, VirtualRig
from tests.soak.wire import Wire

PATIENCE_NS = 30 * SECOND
STEP_NS = 10 * MS
START_US = 2000.0
REASONS = [*LossReason, *map(missing, SIDES)]
"""Why a rig of two cameras may lose a trigger."""


class SteadyLoop:
    """Always asks for the same: virtual frames have no picture to judge."""

    flicker_hz: float | None = None
    light_belief: float | None = None
    uncounted: Mapping[CameraName, str] = MappingProxyType({})

    def __init__(self, limits: ExposureLimits, setting: ExposureSetting) -> None:
        self.setup = dataclasses.make_dataclass("Setup", ["limits"])(limits)
        self._decision = Decision(setting, setting.level, "steady", 0.5, 0.0, 0.0, 0.0)

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        return self._decision


class SteadyTuning(Tuning):
    def loop(self, limits: ExposureLimits) -> SteadyLoop:  # type: ignore[override]
        return SteadyLoop(limits, self.config.start)


def tuning(exposure_time_us: float, **sections: Any) -> SteadyTuning:
    """That of a configuration which keeps to an exposure time; `sections` replace those of the rig's."""
    plain = CONFIG.model_dump(exclude_unset=True)
    start = {"control": {"start": {"exposure_time_us": exposure_time_us}}}
    return SteadyTuning(Config.model_validate(plain | start | sections))


class VirtualRun:
    """A rig that has just begun to expose, with the books of what it counts and says."""

    def __init__(self, new_device: Callable[[CameraName, Clock, int], Device] = Device, **sections: Any) -> None:
        self.pairs: list[FrameSet] = []
        self.said: list[str] = []
        self.rig = VirtualRig(7, self._see_pair, self._see_health, tuning(START_US, **sections), new_device)
        self.left, self.right = self.rig.devices
        self.wire = Wire(self.rig, self.rig.clock.now_ns + 3 * SECOND)
        self.wait_until(lambda: len(self.pairs) >= 30, "pairs")
        self._between_pulses()
        self._before, self._triggers = self.counts(), self.wire.triggers
        self.said.clear()

    @property
    def telemetry(self) -> Telemetry:
        return self.rig.control.telemetry

    def ask(self, exposure_time_us: float, **sections: Any) -> None:
        """Have both cameras written."""
        self.rig.control.tune(tuning(exposure_time_us, **sections))

    def let_pass(self, periods: float) -> None:
        self.rig.run(self.wire.actors, self.rig.clock.now_ns + round(periods * PERIOD_NS))

    def wait_until(self, condition: Callable[[], bool], what: str) -> None:
        deadline_ns = self.rig.clock.now_ns + PATIENCE_NS
        while not condition():
            assert self.rig.clock.now_ns < deadline_ns, f"waited in vain for {what}: {self.said}"
            self.rig.run(self.wire.actors, self.rig.clock.now_ns + STEP_NS)

    def wait_for_state(self, *words: str) -> None:
        """Until the last state said has these words in it."""
        self.wait_until(lambda: bool(self.said) and all(word in self.said[-1] for word in words), " ".join(words))

    def wait_for_taken(self, exposure_time_us: float) -> None:
        """Until both cameras' frames are taken with this exposure time."""

        def taken() -> bool:
            frames = self.pairs[-1].frames
            return len(frames) == 2 and all(
                frame.setting.exposure_time_us == exposure_time_us for frame in frames.values()
            )

        self.wait_until(taken, f"frames of {exposure_time_us:g} us")

    def counts(self) -> Counter[str]:
        counts = Counter({c.name: n for c, n in counters(self.telemetry.counts) if c.unusual or c.name == "pairs"})
        counts.update({str(reason): count for reason, count in self.rig.control.record.tally.lost.items()})
        return +counts

    def counted(self) -> Counter[str]:
        """What was counted since the rig began to expose; all is well again, and every trigger accounted for."""
        if self.said:
            self.wait_for_state("exposing")
        self.let_pass(30)
        self._between_pulses()
        counts, triggers = self.counts(), self.wire.triggers - self._triggers
        counts.subtract(self._before)
        assert counts["pairs"] + sum(counts[reason] for reason in REASONS) == triggers, (
            f"{triggers} triggers: {+counts}"
        )
        del counts["pairs"]
        return +counts

    def _between_pulses(self) -> None:
        """Up to the next pulse, when the frames of the one before are decided on."""
        self.rig.run(self.wire.actors, int(self.wire.actors[0].due_ns) - 1)

    def _see_pair(self, step: ControlStep) -> None:
        pair = step.pair
        self.pairs.append(pair)
        pulses = {frame.pulse for frame in pair.frames.values() if isinstance(frame, VirtualFrame)}
        assert len(pulses) == 1, f"a pair of the pulses {pulses}"

    def _see_health(self, _now_ns: int, health: Health) -> None:
        self.said.append(str(health))


EXACT_NS = 3 * ERROR_NS + 100
"""How far apart exposures are while both clocks are synchronised: each by its error, and its drift in half a second."""
HELD_NS = MS
"""And otherwise: by the host's readings of the clocks, once a second."""


class HostRun(ABC):
    """Two cameras that the host triggers, `rate_hz` times a second, from when the rig opens them.

    `phase_ms` is as in the configuration.
    """

    def __init__(
        self,
        mode: str,
        rate_hz: float,
        new_device: Callable[[CameraName, Clock, int], Device] = Device,
        phase_ms: float | None = None,
    ) -> None:
        self.rate_hz = rate_hz
        self.said: list[str] = []
        trigger = {"mode": mode, "rate_hz": rate_hz, "phase_ms": phase_ms}
        self.rig = VirtualRig(7, self._see_pair, self._see_health, tuning(START_US, trigger=trigger), new_device)
        self.actors: list[Any] = []

    def let_pass(self, seconds: float) -> None:
        self.rig.run(self.actors, self.rig.clock.now_ns + round(seconds * SECOND))

    @abstractmethod
    def _see_pair(self, step: ControlStep) -> None:
        """What a run looks at."""

    def _see_health(self, _now_ns: int, health: Health) -> None:
        self.said.append(str(health))


class PtpRun(HostRun):
    """With a PTP master, if there is one, and clocks that drift."""

    def __init__(self, rate_hz: float = 20.0, phase_ms: float | None = None) -> None:
        self.apart_ns: list[int] = []
        self.pairs: list[FrameSet] = []
        self.alone = 0
        self.master = Master()
        super().__init__("ptp", rate_hz, PtpDevice, phase_ms)
        left, right = self.rig.devices
        assert isinstance(left, PtpDevice) and isinstance(right, PtpDevice)
        self.left, self.right = left, right
        for unit in self.rig.units.values():
            assert isinstance(unit.device, PtpDevice)
            unit.device.on_frame = unit.plan_frames
            unit.device.master = self.master
        self.actors = [actor for device in (left, right) for actor in device.actors]

    def begin(self) -> None:
        """Until pairs have come for a second."""
        self.let_pass(10.0)
        assert len(self.apart_ns) >= self.rate_hz
        assert self.said == ["exposing"]
        self.apart_ns.clear()
        self.said.clear()

    def end(self, most_surplus: int = 0) -> Counter[str]:
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
        self.pairs.append(pair)
        self.apart_ns.append(abs(times_ns[0] - times_ns[1]))
        assert self.apart_ns[-1] < SECOND / self.rate_hz / 2, "a pair of two instants"

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
