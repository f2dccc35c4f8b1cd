"""Control of a rig: decides on the pairs of its record, has the cameras written, delivers pairs and decisions."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Protocol

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.request import Request
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.runtime.inputs import InputSource
from autoexpose_daemon.runtime.requests import Requests
from autoexpose_daemon.runtime.rig_health import RigHealth
from autoexpose_daemon.runtime.setup import ActiveLoop, Tuning
from autoexpose_daemon.status.counters import Answer
from autoexpose_daemon.status.telemetry import Telemetry
from drivers.rig.events import (
    CameraGone,
    CameraReady,
    CameraSilent,
    ClockRead,
    FrameArrived,
    PacketsRefused,
    RigEvent,
    WriteFailed,
    Written,
)
from drivers.rig.supervision import Slots
from drivers.triggers import RigRecord
from drivers.triggers.host import HostTriggers, PtpTriggers, ReadoutTimes, SoftwareTriggers
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, FrameSet

Outlet = Callable[[ControlStep], None]
"""Called with every pair, on the control thread, so it must return at once. One that is a context manager is open while
the daemon runs."""


class Cameras(Protocol):
    """What control needs from a rig."""

    def write(self, setting: ExposureSetting, not_before_ns: int, command: int) -> None:
        """Write `setting` to every camera, no earlier than `not_before_ns`, as this command; replaces a pending one."""

    def pace(self, camera: CameraName, slots: Slots) -> None:
        """Trigger a camera in these slots until it is closed; replaces, or moves, the former ones."""

    def reopen(self, camera: CameraName, why: str) -> None:
        """Close and reopen a camera that answers but sends nothing; `why` follows its name in a sentence."""


def _host_triggers(config: Config, now_ns: int) -> HostTriggers:
    match config.trigger.mode:
        case "software":
            return SoftwareTriggers(config.trigger.rate_hz, now_ns)
        case "ptp":
            return PtpTriggers(config.trigger.rate_hz)
        case _:
            return HostTriggers()


class RigControl:
    """Keeps the cameras of a rig well exposed, based on what they report."""

    def __init__(
        self,
        config: Config,
        cameras: Cameras,
        start: ExposureSetting | None = None,  # the setting that the cameras start with; None: as configured
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,  # another clock in virtual time
    ) -> None:
        self.telemetry = Telemetry(period_s=1.0 / config.trigger.rate_hz)
        self.outlets: list[Outlet] = []
        self.sources: dict[str, InputSource] = {}  # by field of `StepInputs`
        mode = config.trigger.mode if config.trigger.mode != "primary" else "external"
        self.record = RigRecord(tuple(config.cameras), config.trigger_sources, config.trigger.rate_hz, now_ns(), mode)
        self.active = ActiveLoop(Tuning(config))  # also for outlets, which run on its thread
        period_ns = 1e9 / config.trigger.rate_hz
        self.requests = Requests(self.active, self.telemetry.requests, start or config.start, period_ns)
        self._cameras = cameras
        self._now_ns = now_ns
        self._triggers = _host_triggers(config, now_ns())
        self._readout_times = ReadoutTimes()
        self._health = RigHealth(config, self.telemetry, self.record, self._triggers)
        self._asked: ExposureSetting | None = start or config.start  # None: write the next one, even if it is the same
        self._last_trigger = -1
        self._joins = False  # a camera is open, and no pair with it has been decided on yet

    def begin(self) -> None:
        """Count triggers from now on; until then another daemon may take them."""
        self.record.begin(self._now_ns())

    def tune(self, tuning: Tuning) -> None:
        """Switch to another tuning; ConfigurationError, with nothing changed, if it does not fit cameras or frames."""
        self.active.tune(tuning)
        self._health.tune(tuning)
        self.requests.drop()

    def ask(self, request: Request, answer: Future[Answer]) -> None:
        """Change what a request asks for, and answer it; see `Requests.ask`."""
        self.requests.ask(request, answer, self._now_ns())

    def close(self) -> None:
        """Account for the triggers up to now that will never make a pair."""
        self.record.close(self._now_ns())
        self.telemetry.account(self.record)

    def take(self, events: Sequence[RigEvent]) -> None:
        """Act on all events since the last call; also called without events, ten times a second.

        Raises ConfigurationError, UnsupportedCameraError or NodeError when a camera cannot be driven as configured, at
        the start or if no other one is left.
        """
        pairs = [pair for event in events for pair in self._enter(event)]
        if pairs:
            newest = max(pairs, key=lambda pair: (pair.trigger, len(pair.frames)))
            decides = newest.trigger > self._last_trigger  # a pair may come after one of its frames was used alone
            for pair in pairs:
                if not (decides and pair.trigger == newest.trigger) and self._complete(pair):
                    self._pass_over(pair)
            if decides:
                self._last_trigger = newest.trigger
                self._joins = self._joins and not self._complete(newest)
                self._step(newest)
        self.requests.look(self._now_ns())
        if events:
            self.telemetry.account(self.record)
        for camera, why in self._health.look(self._now_ns()).items():
            self._cameras.reopen(camera, why)

    def _pass_over(self, pair: FrameSet) -> None:
        """A complete pair without a decision; consumers get it, unless they have had one of its frames alone.

        Nothing went wrong if the first frames of a camera complete pairs whose other frame has been decided on.
        """
        if not (self._joins and pair.trigger <= self._last_trigger):
            self.telemetry.counts.pairs_without_decision += 1
        self.requests.passed_over(pair)
        if pair.trigger > self._last_trigger:
            for source in self.sources.values():
                source.passed_over(pair)
            self._deliver(ControlStep(StepInputs(pair)))

    def _enter(self, event: RigEvent) -> list[FrameSet]:
        """Dispatch an event: to the triggers and the record, then to whom it concerns; returns the pairs it completed.

        Nobody else looks at what kind of event it is.
        """
        now_ns, shot = self._now_ns(), self.requests.shot
        event = self._triggers.placed(self._readout_times.placed(event))
        for camera, slots in self._triggers.see(event, now_ns).items():
            self._cameras.pace(camera, slots)
            self.record.paced(camera, now_ns)
        pairs = [] if isinstance(event, Written) else self.record.take(event, now_ns)
        match event:
            case FrameArrived(camera, frame, stale):
                self._health.arrived(camera, frame, stale, now_ns)
            case Written(camera):
                self.telemetry.written(event, self.record.written(event))
                self._health.written(event)
                if shot is not None:
                    shot.written(camera, event.command, event.finished_ns)
            case WriteFailed(camera):
                self._health.write_failed(event)
                if shot is not None:
                    shot.write_failed(camera)
                self._asked = None
            case CameraReady():
                self._health.ready(event)
                self.active.ready(event)
                self._joins = True
            case CameraGone(camera):
                self._health.gone(event, now_ns)
                if shot is not None:
                    shot.gone(camera)
            case CameraSilent(camera):
                self._health.silent(camera, now_ns)
            case ClockRead(camera, reading):
                self._health.clock_read(camera, reading)
            case PacketsRefused(camera, packets):
                self._health.packets_refused(camera, packets)
        return pairs

    def _step(self, pair: FrameSet) -> None:
        started_ns = self._now_ns()
        taken_ns = min(frame.host_time_ns for frame in pair.frames.values())
        known = {name: source(taken_ns) for name, source in self.sources.items()}
        inputs = StepInputs(pair, override=self.requests.override(pair), **known)
        decision = self.active.step(inputs)
        if decision is None or self.active.loop is None:
            return
        decided_ns = self._now_ns()
        arrival_ns = max(frame.arrival_time_ns for frame in pair.frames.values())
        self.telemetry.pairing_ms.add_ns(started_ns - arrival_ns)
        self.telemetry.decision_ms.add_ns(decided_ns - started_ns)
        self.telemetry.decided(decision, self.active.loop.setup.limits, self.active.loop.flicker_hz)
        self._health.counted(pair, self.active.loop.uncounted)
        written_to: list[CameraName] = []
        if decision.setting != self._asked and not self._awaits_shot(decided_ns):
            self._asked, written_to = decision.setting, self.telemetry.cameras.present
            command = self.record.command(decision.setting, arrival_ns, decided_ns)
            self._cameras.write(decision.setting, command.due_ns, command.number)
            self.requests.commanded(command.number)
        self.requests.decided(decision, written_to, self.telemetry.cameras.present)
        for source in self.sources.values():
            source.decided(inputs, self.active.loop)
        self._deliver(ControlStep(inputs, decision, self.requests.taken()))

    def _awaits_shot(self, decided_ns: int) -> bool:
        """Whether what was decided now would replace the setting of a shot before an exposure was made with it."""
        shot = self.requests.shot
        if shot is None or not shot.is_decided:
            return False
        return bool(shot.unwritten) or not self.record.exposes_before_write(shot.written_ns, decided_ns)

    def _deliver(self, step: ControlStep) -> None:
        """Record what a pair shows, and pass it on."""
        pair = step.pair
        self.telemetry.delivered(pair, self.record, self._triggers.skew_ns(pair), complete=self._complete(pair))
        self._health.pair(pair)
        for outlet in self.outlets:
            outlet(step)

    def _complete(self, pair: FrameSet) -> bool:
        return len(pair.frames) == len(self.active.tuning.config.cameras)
