"""What is requested of control while it runs: checked, put into effect between two pairs, dropped by a reload."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace

from autoexpose_daemon.config.request import Request, ShotRequest
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.step import Override
from autoexpose_daemon.runtime.setup import ActiveLoop, Tuning
from autoexpose_daemon.status.counters import Answer, AnsweredShot, Bounds, GroupAnswer, RequestTally
from drivers.log_throttle import LogThrottle
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import CameraGeometry

log = logging.getLogger(__name__)

PATIENCE_NS = 1_000_000_000
PATIENCE_PERIODS = 8
"""A shot is given up if no frame shows it within the sum of these: the slowest camera reported takes 0.4 s."""

LONGEST_PATIENCE_NS = 8_000_000_000
"""The caller waits for 10 s."""


@dataclass(slots=True, eq=False)
class PendingShot:
    """A shot that was asked for, and not yet seen."""

    setting: ExposureSetting  # what to take the pair with
    deadline_ns: int  # when to give up
    answer: Future[Answer]
    rig: Sequence[CameraName]  # all its cameras, in the order of the configuration
    is_decided: bool = False  # whether the step that asks the cameras for it has been made
    command: int = 0  # the number of the latest command before it is decided on, and then of its own
    unwritten: set[CameraName] = field(default_factory=set)  # cameras that are still to be written
    written_ns: int = 0  # when the last of the other cameras was written (CLOCK_MONOTONIC)
    _cameras: set[CameraName] = field(default_factory=set)
    _seen: dict[CameraName, tuple[int, Frame]] = field(default_factory=dict)  # with the trigger

    def decided(self, written_to: Iterable[CameraName], present: Iterable[CameraName]) -> None:
        """The cameras that are present are asked for it; some of them will be written."""
        self.is_decided, self.unwritten, self._cameras = True, set(written_to), set(present)

    def written(self, camera: CameraName, command: int, finished_ns: int) -> None:
        """A camera was written for a command."""
        if command == self.command:
            self.unwritten.discard(camera)
            self.written_ns = finished_ns

    def write_failed(self, camera: CameraName) -> None:
        """A camera refused what it was written."""
        self.unwritten.discard(camera)

    def gone(self, camera: CameraName) -> None:
        """A camera is lost."""
        self.unwritten.discard(camera)
        self._cameras.discard(camera)

    def is_in(self, pair: FrameSet) -> bool:
        """Whether a frame of a pair was taken for it: only the first such frame of each camera was."""
        if not self.is_decided:
            return False
        showing = {
            camera: (pair.trigger, frame)
            for camera, frame in pair.frames.items()
            if frame.setting.agrees_with(self.setting)
        }
        new = bool(showing.keys() - self._seen.keys())
        if new and showing.keys() >= self._cameras:  # regardless of frames of it seen alone before
            self._seen = showing
        elif new:
            self._seen = showing | self._seen
        return new

    def found(self) -> AnsweredShot | None:
        """The frames taken for it, once every camera that is still there has shown it.

        The trigger is that of the first camera that has shown it: one that was written late shows it a frame later.
        """
        if not self._seen or not self._seen.keys() >= self._cameras:
            return None
        trigger, frame = next(self._seen[camera] for camera in self.rig if camera in self._seen)
        return AnsweredShot(
            frame.setting, trigger, {camera: frame.frame_id for camera, (_, frame) in self._seen.items()}
        )

    @property
    def why_late(self) -> str:
        """Why it was not answered in time."""
        missing = " and ".join(sorted(self._cameras - self._seen.keys()))
        if not self._seen or not missing:  # nothing is missing once all cameras are gone
            return "no frame was taken with it in time: are there pairs, and does the camera take the setting?"
        return f"no frame of the {missing} camera was taken with it in time, or it was lost: ask again"


_REFUSALS_S = 10.0
_MOST_FRESH = 16  # if no pair arrives


class Requests:
    """Holds what was requested; all methods are called on the control thread.

    Policy, limits and regions are the tuning of the active loop; the rest goes into each of its steps.
    """

    def __init__(self, active: ActiveLoop, tally: RequestTally, start: ExposureSetting, period_ns: float) -> None:
        self.shot: PendingShot | None = None  # that is under way
        self._active = active
        self._tally = tally
        self._fresh: tuple[str, ...] = ()
        self._configured = active.tuning
        self._decided = start
        self._override = Override()
        self._patience_ns = round(PATIENCE_NS + PATIENCE_PERIODS * period_ns)
        self._throttle = LogThrottle(_REFUSALS_S)

    def ask(self, request: Request, answer: Future[Answer], now_ns: int) -> None:
        """Answer a request, at once or when its shot is seen; a refusal carries its error and changes nothing."""
        if not answer.set_running_or_notify_cancel():
            return
        try:
            shot = self._apply(request)
        except ConfigurationError as error:
            self._tally.refused += 1
            if self._throttle.due("refused", now_ns):
                log.info("refused: %s: %s", request.in_full, error)
            answer.set_exception(error)
            return
        if request.words:
            self._note(request)
        if shot is None:
            answer.set_result(self._answer())
        else:
            rig = tuple(self._configured.config.cameras)
            self.shot = PendingShot(shot, now_ns + self._patience_ns, answer, rig)

    def check(self, request: Request) -> None:
        """Raise ConfigurationError for a request that would be refused; change nothing."""
        self._prepared(request)

    def calibrate(self, geometries: Mapping[CameraName, CameraGeometry | None]) -> None:
        """Have frames go out with the geometry of these cameras, which changes nothing else, and outlives requests."""
        is_as_configured = self._active.tuning is self._configured
        self._active.tuning = self._active.tuning.calibrated(geometries)
        self._configured = self._active.tuning if is_as_configured else self._configured.calibrated(geometries)

    def drop(self) -> None:
        """Return to the configuration, which is now the tuning of the active loop."""
        if words := str(self._tally):
            log.info("the configuration replaces what was requested: %s", words)
        self._configured = self._active.tuning
        self._tally.locked, self._tally.ev_stops, self._tally.changed = None, 0.0, ()
        self._note_bounds()
        self._give_up("the configuration was reloaded meanwhile")

    def override(self, pair: FrameSet) -> Override:
        """What applies to the step on a pair."""
        held, shot, unseen = self._tally.locked, None, False
        if self.shot is not None:
            unseen = self.shot.is_in(pair)
            shot = None if self.shot.is_decided else self.shot.setting
        if unseen and held is None:
            held = self._decided
        self._override = Override(self._tally.ev_stops, held, shot, unseen)
        return self._override

    def commanded(self, command: int) -> None:
        """A command with this number is on its way: that of the shot, if it is just being decided on."""
        if self.shot is not None and not self.shot.is_decided:
            self.shot.command = command

    def decided(self, decision: Decision, written_to: Iterable[CameraName], present: Iterable[CameraName]) -> None:
        """The step was made; some of the cameras present will be written."""
        if self._override.shot is None:
            self._decided = decision.setting
            if self._tally.locked is not None:
                self._tally.locked = decision.setting  # within bounds that may have changed
        elif self.shot is not None:
            self.shot.decided(written_to, present)
        found = None if self.shot is None else self.shot.found()
        if self.shot is not None and found is not None:
            log.info("the shot is trigger %d, %s", found.trigger, found.setting)
            self.shot.answer.set_result(self._answer(found))
            self.shot = None

    def taken(self) -> tuple[str, ...]:
        """The requests that took effect with this step, and who asked; each is told once."""
        fresh, self._fresh = self._fresh, ()
        return fresh

    def passed_over(self, pair: FrameSet) -> None:
        """Control had no time for a pair, which may contain a shot."""
        if self.shot is not None:
            self.shot.is_in(pair)

    def look(self, now_ns: int) -> None:
        """To be called at least ten times a second."""
        self._note_bounds()
        if self.shot is not None and now_ns > self.shot.deadline_ns:
            self._give_up(self.shot.why_late)

    def _apply(self, request: Request) -> ExposureSetting | None:
        """Make all changes, or raise ConfigurationError; returns the setting of a shot, which is still to be taken."""
        if not request.words:
            return None
        tuning, loop, locked, ev_stops, shot = self._prepared(request)
        # Nothing is refused from here on.
        if tuning is not self._active.tuning:
            self._active.use(tuning, loop)
        self._tally.locked, self._tally.ev_stops = locked, ev_stops
        self._tally.changed = tuning.differs_from(self._configured)
        self._tally.bounds = Bounds.of(loop.setup.limits)
        return shot

    def _prepared(
        self, request: Request
    ) -> tuple[Tuning, ControlLoop, ExposureSetting | None, float, ExposureSetting | None]:
        """What a request would change: tuning and its loop, locked setting, EV compensation, and the shot to take."""
        tuning = self._configured if request.reset else self._active.tuning
        tuning = tuning.changed(request)
        loop = self._active.loop
        if tuning is not self._active.tuning:
            loop = self._active.prepared(tuning)
        ev_stops = 0.0 if request.reset else self._tally.ev_stops
        ev_stops = ev_stops if request.ev_stops is None else request.ev_stops
        locked = None if request.reset else self._tally.locked
        if request.locked is not None:
            locked = (locked or self._decided) if request.locked else None
        if loop is None or not self._knows_enough(request):
            raise ConfigurationError("not every camera has been open yet: ask again when it has")
        loop.check_ev(ev_stops)
        shot = None if request.shot is None else self._shot_within(loop.setup.limits, request.shot)
        return tuning, loop, locked, ev_stops, shot

    def _knows_enough(self, request: Request) -> bool:
        """Whether the cameras that a request concerns have been open, so that it can be checked."""
        concerned = set(request.regions)
        if request.limits is not None:
            concerned |= self._active.tuning.config.cameras.keys()
        return self._active.cameras.keys() >= concerned

    def _shot_within(self, limits: ExposureLimits, request: ShotRequest) -> ExposureSetting:
        setting = ExposureSetting(request.exposure_time_us, request.gain_db)
        if self._patience_ns > LONGEST_PATIENCE_NS:
            raise ConfigurationError("triggers are too rare for a shot: set trigger.rate_hz to at least 1.2")
        if self.shot is not None:
            raise ConfigurationError("another shot is under way: ask again")
        if not limits.contain(setting):
            raise ConfigurationError(f"{request.words} is out of bounds: give {Bounds.of(limits)}")
        return limits.rounded(setting)

    def _note(self, request: Request) -> None:
        self._tally.taken += 1
        self._tally.latest = request.in_full
        self._fresh = (*self._fresh, self._tally.latest)[-_MOST_FRESH:]
        log.info("%s", self._tally.latest)

    def _note_bounds(self) -> None:
        """Also without decisions: a camera may open, or a reload may change them, while there are no triggers."""
        if self._active.loop is not None:
            self._tally.bounds = Bounds.of(self._active.loop.setup.limits)

    def _give_up(self, why: str) -> None:
        if self.shot is not None:
            self.shot.answer.set_exception(AutoexposeError(f"the shot failed: {why}"))
            self.shot = None

    def answer(self) -> GroupAnswer:
        """What applies now."""
        return GroupAnswer(self._active.tuning.config.control.policy, replace(self._tally))

    def _answer(self, shot: AnsweredShot | None = None) -> Answer:
        now = self.answer()
        return Answer(now.policy, now.requests, shot)
