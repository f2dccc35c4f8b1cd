"""Control of a rig: decides on the pairs of its record, has the cameras written, delivers pairs and decisions."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Protocol

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.request import Request
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.messages.frames import realtime_offset_ns
from autoexpose_daemon.runtime.group_control import GroupControl, starts
from autoexpose_daemon.runtime.inputs import InputSource
from autoexpose_daemon.runtime.rig_health import RigHealth
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.status.counters import Answer
from autoexpose_daemon.status.telemetry import GroupTally, Telemetry
from drivers.rig.events import (
    CameraGone,
    CameraReady,
    CameraSilent,
    ClockRead,
    Command,
    FrameArrived,
    PacketsRefused,
    RigEvent,
    TemperatureRead,
    WriteFailed,
    Written,
)
from drivers.rig.supervision import Slots
from drivers.triggers import RigRecord
from drivers.triggers.host import (
    HostTriggers,
    PhasedSoftwareTriggers,
    PtpTriggers,
    ReadoutTimes,
    SoftwareTriggers,
)
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, FrameSet

Outlet = Callable[[ControlStep], None]
"""Called with every pair, on the control thread, so it must return at once. One that is a context manager is open while
the daemon runs."""


class Cameras(Protocol):
    """What control needs from a rig."""

    def write(self, command: Command) -> None:
        """Write a setting to its cameras, no earlier than it is due; replaces pending ones."""

    def pace(self, camera: CameraName, slots: Slots) -> None:
        """Trigger a camera in these slots until it is closed; replaces, or moves, the former ones."""

    def reopen(self, camera: CameraName, why: str) -> None:
        """Close and reopen a camera that answers but sends nothing; `why` follows its name in a sentence."""


def _host_triggers(config: Config, now_ns: int, realtime_offset_ns: Callable[[], int]) -> HostTriggers:
    rate_hz, phase_ms = config.trigger.rate_hz, config.trigger.phase_ms
    phase_ns = None if phase_ms is None else round(1e6 * phase_ms)
    match config.trigger.mode:
        case "software" if phase_ns is not None:
            return PhasedSoftwareTriggers(rate_hz, now_ns, phase_ns, realtime_offset_ns)
        case "software":
            return SoftwareTriggers(rate_hz, now_ns)
        case "ptp":
            return PtpTriggers(rate_hz, phase_ns)
        case _:
            return HostTriggers()


def _pass_on(answer: Future[Answer], groups: Mapping[str, GroupControl], of_first: Future[Answer]) -> None:
    """Answer as the first of these groups did, and for all of them."""
    if (error := of_first.exception()) is not None:
        answer.set_exception(error)
    else:
        answers = {name: group.requests.answer() for name, group in groups.items()}
        answer.set_result(replace(of_first.result(), groups=answers))


class RigControl:
    """Keeps the cameras of a rig well exposed, based on what they report."""

    def __init__(
        self,
        config: Config,
        cameras: Cameras,
        start: ExposureSetting | None = None,  # the setting that the cameras start with; None: as configured
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,  # another clock in virtual time
        realtime_offset_ns: Callable[[], int] = realtime_offset_ns,
    ) -> None:
        self.telemetry = Telemetry(period_s=1.0 / config.trigger.rate_hz)
        self.outlets: list[Outlet] = []
        self.sources: dict[str, InputSource] = {}  # by field of `StepInputs`
        mode = config.trigger.mode if config.trigger.mode != "primary" else "external"
        self.config = config
        groups = config.cameras_of_groups
        self.record = RigRecord(
            tuple(config.cameras),
            config.trigger_sources,
            config.trigger.rate_hz,
            now_ns(),
            mode,
            groups=groups.values(),
        )
        self.telemetry.groups = {name: GroupTally() for name in groups}
        begins, period_ns = starts(config, start), 1e9 / config.trigger.rate_hz
        self.groups = {
            name: GroupControl(config.of_group(name), tally, begins[groups[name][0]], period_ns)
            for name, tally in self.telemetry.groups.items()
        }
        self._cameras = cameras
        self._now_ns = now_ns
        self._triggers = _host_triggers(config, now_ns(), realtime_offset_ns)
        self._readout_times = ReadoutTimes()
        self._health = RigHealth(config, self.telemetry, self.record, self._triggers, realtime_offset_ns)
        self._last_trigger = -1
        self._joins = False  # a camera is open, and no pair with it has been decided on yet

    def begin(self) -> None:
        """Count triggers from now on; until then another daemon may take them."""
        self.record.begin(self._now_ns())

    def tune(self, tuning: Tuning) -> None:
        """Switch to another tuning; ConfigurationError, with nothing changed, if it does not fit cameras or frames."""
        parts = [(group, tuning.of_group(name)) for name, group in self.groups.items()]
        loops = [group.active.prepared(part) for group, part in parts]
        for (group, part), loop in zip(parts, loops, strict=True):  # nothing is refused from here on
            group.active.use(part, loop)
            group.requests.drop()
        self.config = tuning.config
        self._health.tune(tuning)

    def ask(self, request: Request, answer: Future[Answer]) -> None:
        """Change what a request asks for, and answer it; see `Requests.ask`."""
        if not answer.set_running_or_notify_cancel():
            return
        try:
            concerned = self._concerned(request)
        except ConfigurationError as error:
            self.telemetry.requests.refused += 1
            answer.set_exception(error)
            return
        (first, of_first), *others = [(group, self._part(request, name)) for name, group in concerned.items()]
        for group, part in others:  # before the first, whose answer tells what came of it
            group.requests.ask(part, Future(), self._now_ns())
        done: Future[Answer] = Future()
        done.add_done_callback(partial(_pass_on, answer, concerned))
        first.requests.ask(of_first, done, self._now_ns())

    def _concerned(self, request: Request) -> dict[str, GroupControl]:
        """The groups that a request is for, which all take it; ConfigurationError if there is none, or one does not."""
        if request.group is not None and request.group not in self.groups:
            raise ConfigurationError(f"there is no group {request.group}: give one of {', '.join(self.groups)}")
        if strangers := request.regions.keys() - self.config.cameras.keys():
            raise ConfigurationError(f"region.{min(strangers)}: the rig has no {min(strangers)} camera: leave it out")
        groups = {name: group for name, group in self.groups.items() if request.group in (None, name)}
        if others := request.regions.keys() - {camera for group in groups.values() for camera in group.cameras}:
            raise ConfigurationError(f"region.{min(others)}: that camera is not in group {request.group}: leave it out")
        if request.only_regions:
            groups = {name: group for name, group in groups.items() if request.regions.keys() & set(group.cameras)}
        if len(groups) > 1:
            if request.shot is not None:
                raise ConfigurationError(f"a shot is of one group: give group, one of {', '.join(self.groups)}")
            for name, group in groups.items():
                group.requests.check(self._part(request, name))
        return groups

    def _part(self, request: Request, group: str) -> Request:
        """What a request is for one group."""
        return request.of(group if len(self.groups) > 1 else None, self.groups[group].cameras)

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
        for group in self.groups.values():
            group.look(self._now_ns())
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
        for group in self.groups.values():
            if (part := pair.of(group.cameras)) is not None:
                group.requests.passed_over(part)
        if pair.trigger > self._last_trigger:
            for source in self.sources.values():
                source.passed_over(pair)
            self._deliver(ControlStep(StepInputs(pair)))

    def _enter(self, event: RigEvent) -> list[FrameSet]:
        """Dispatch an event: to the triggers and the record, then to whom it concerns; returns the pairs it completed.

        Nobody else looks at what kind of event it is.
        """
        now_ns = self._now_ns()
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
                if (shot := self._group_of(camera).requests.shot) is not None:
                    shot.written(camera, event.command, event.finished_ns)
            case WriteFailed(camera):
                self._health.write_failed(event)
                group = self._group_of(camera)
                if group.requests.shot is not None:
                    group.requests.shot.write_failed(camera)
                group.asked = None
            case CameraReady(camera):
                self._health.ready(event)
                self._group_of(camera).active.ready(event)
                self._joins = True
            case CameraGone(camera):
                self._health.gone(event, now_ns)
                if (shot := self._group_of(camera).requests.shot) is not None:
                    shot.gone(camera)
            case CameraSilent(camera):
                self._health.silent(camera, now_ns)
            case ClockRead() | TemperatureRead():
                self._health.told(event, now_ns)
            case PacketsRefused(camera, packets):
                self._health.packets_refused(camera, packets)
        return pairs

    def _group_of(self, camera: CameraName) -> GroupControl:
        return next(group for group in self.groups.values() if camera in group.cameras)

    def _step(self, pair: FrameSet) -> None:
        taken_ns = min(frame.host_time_ns for frame in pair.frames.values())
        known = {name: source(taken_ns) for name, source in self.sources.items()}
        inputs = StepInputs(pair, **known)
        arrival_ns = max(frame.arrival_time_ns for frame in pair.frames.values())
        self.telemetry.pairing_ms.add_ns(self._now_ns() - arrival_ns)
        steps = {name: step for name, group in self.groups.items() if (step := self._decide(group, inputs)) is not None}
        if not steps:
            return
        loops = [loop for name in steps if (loop := self.groups[name].active.loop) is not None]
        for source in self.sources.values():
            source.decided(inputs, loops)
        first = next(iter(steps.values()))
        whole = first if len(self.groups) == 1 else replace(first, inputs=inputs, groups=steps)
        self._deliver(whole)

    def _decide(self, group: GroupControl, inputs: StepInputs) -> ControlStep | None:
        """Decide for one group, and have its cameras written."""
        started_ns = self._now_ns()
        step = group.step(inputs, first=group is self.first)
        if step is None or step.decision is None or group.active.loop is None:
            return None
        decision, decided_ns = step.decision, self._now_ns()
        group.tally.decision_ms.add_ns(decided_ns - started_ns)
        self.telemetry.decision_ms.add_ns(decided_ns - started_ns)
        self.telemetry.decided(decision, group.active.loop.setup.limits)
        self._health.counted(step.pair, group.active.loop.uncounted)
        present = [camera for camera in self.telemetry.cameras.present if camera in group.cameras]
        written_to: list[CameraName] = []
        if decision.setting != group.asked and not self._awaits_shot(group, decided_ns):
            group.asked, written_to = decision.setting, present
            arrival_ns = max(frame.arrival_time_ns for frame in step.pair.frames.values())
            command = self.record.command(decision.setting, arrival_ns, decided_ns, group.cameras)
            self._cameras.write(command)
            group.requests.commanded(command.number)
        group.requests.decided(decision, written_to, present)
        return replace(step, requests=group.requests.taken())

    @property
    def first(self) -> GroupControl:
        """The group of the first camera."""
        return next(iter(self.groups.values()))

    def _awaits_shot(self, group: GroupControl, decided_ns: int) -> bool:
        """Whether what was decided now would replace the setting of a shot before an exposure was made with it."""
        shot = group.requests.shot
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
        return len(pair.frames) == len(self.config.cameras)
