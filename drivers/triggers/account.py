"""The account of triggers: each becomes a pair, or is lost for exactly one reason.

The host does not see triggers. It infers them from the camera's frame counter (a gap means frames that were taken and
did not arrive), the time stamps of frames (a gap in time without one in the counter means triggers that the camera did
not take), and the trigger period (how many triggers an outage swallowed).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from drivers.camera import IncompleteFrame
from drivers.triggers.outcomes import Fate, Outcome, Outcomes, Tally, loss_reason, stopped
from drivers.triggers.rate import TriggerGrid
from imaging.frames import CameraName, Frame, FrameSet

_SILENCE_PERIODS = 30
"""A pause of this many periods on every camera, with no frame missing, means that the trigger had stopped."""

_HOLD_PERIODS = 8
"""A frame waits this long for one of a camera that is silent or coming back; it is handed out without it meanwhile."""

_NEXT_PERIODS = 0.75
"""No trigger follows a frame on the grid sooner: a frame in between could be paired with another instant's."""

_INSTANT_PERIODS = 0.4
"""Frames that start further apart are of different instants: both may be near one trigger of a grid that has moved."""

_SURPLUS = -1
"""In place of a trigger number, for a surplus frame."""

_REORDERED_FRAMES = 8
"""A frame id further back than this is no late frame's."""

_PATIENCE_PERIODS = 600
"""Triggers are kept open this long for a camera that answers but sends no frames; bounds the memory they take."""


@dataclass(slots=True)
class _Track:
    """What is known of one camera."""

    streaming: bool = False
    silent: bool = True
    gap_fate: Fate = Fate.STARTUP  # what happened to triggers before the first frame of the next session
    frame_id: int = 0
    trigger: int = -1  # of the newest frame in this session
    ready_ns: int | None = None  # since when it has waited for its first frame; None: not open, or it has arrived
    alone: int = -1  # the newest trigger whose frame was handed out in a set without all cameras
    not_given: int = 0  # triggers that the host did not give since its newest frame
    resumed: int = 0  # the trigger of its first frame after the latest long silence
    stopped: int = 0  # how many triggers that silence lasted


class TriggerAccount:
    """Pairs the frames of a rig by trigger, and accounts for every trigger.

    Triggers come every `period_ns` and count from the host time `opened_ns`, or if that is None from when the first
    camera is ready. Frames are numbered by "time", or by "frame_id" if the camera runs freely and so misses no trigger.
    """

    def __init__(
        self,
        cameras: Sequence[CameraName],
        period_ns: float,
        opened_ns: int | None,
        numbered_by: Literal["time", "frame_id"] = "time",
    ) -> None:
        self.tally = Tally()
        self.grid: TriggerGrid | None = None
        self._period_ns = period_ns
        self._opened_ns = opened_ns
        self._numbered_by = numbered_by
        self._tracks: dict[CameraName, _Track] = {camera: _Track() for camera in cameras}
        self._outcomes = Outcomes(cameras)
        self._lone_from = 0  # frames of older triggers have been handed out, in company or alone
        self._on_grid_ns = 0  # the newest frame that a trigger made

    def begin(self, now_ns: int) -> None:
        """Count triggers from now on, before the first event; without effect if they count from the first camera."""
        if self._opened_ns is not None:
            self._opened_ns = now_ns

    def frame(self, camera: CameraName, frame: Frame) -> list[FrameSet]:
        """Account for a frame; returns what is ready for control, oldest first.

        A whole set counts when it is returned. While a camera is silent or gone, the frames of the others are returned
        as sets without it that count as nothing: if its frame arrives after all, the whole set follows.
        """
        return self._arrival(camera, frame.frame_id, frame.host_time_ns, frame)

    def incomplete(self, camera: CameraName, frame: IncompleteFrame) -> list[FrameSet]:
        """Account for a frame that arrived with holes."""
        return self._arrival(camera, frame.frame_id, frame.host_time_ns, Fate.INCOMPLETE)

    def stale(self, camera: CameraName, frame: Frame) -> list[FrameSet]:
        """Account for a frame that arrived when control was too far behind to use it."""
        return self._arrival(camera, frame.frame_id, frame.host_time_ns, Fate.STALE)

    def not_given(self, camera: CameraName, count: int) -> None:
        """The host, which triggers this camera, did not do so `count` times."""
        self._tracks[camera].not_given += count

    def ready(self, camera: CameraName, now_ns: int) -> None:
        """The camera is open and takes triggers from now on."""
        if self._opened_ns is None:
            self._opened_ns = now_ns
        self._tracks[camera].ready_ns = now_ns
        self._tracks[camera].not_given = 0

    def silent(self, camera: CameraName) -> list[FrameSet]:
        """The camera sends nothing, perhaps for good: stop waiting for it."""
        self._tracks[camera].silent = True
        return self._release_lone()

    def gone(self, camera: CameraName) -> list[FrameSet]:
        """The camera is lost, or could not be opened."""
        track = self._tracks[camera]
        track.streaming = False
        track.silent = True
        track.ready_ns = None
        track.gap_fate = Fate.GONE
        return self._release_lone() + self._resolve()

    def close(self, now_ns: int) -> None:
        """Account for the triggers up to now that will never make a pair."""
        if self._opened_ns is None:
            return
        if self.grid is None and all(self._waits_in_vain(track, now_ns) for track in self._tracks.values()):
            return  # there never was a trigger
        if self.grid is None:  # no frame ever showed the phase, but n whole periods hold n triggers whatever it is
            triggers = int((now_ns - self._opened_ns) // self._period_ns)
            self._open_grid(self._opened_ns + round(self._period_ns / 2), 0)
            last = triggers - 1
        else:
            last = self.grid.last_before(now_ns)
        assert self.grid is not None
        tracks = self._tracks.values()
        still = any(track.streaming for track in tracks) and all(track.silent for track in tracks)
        newest = max(track.trigger for track in tracks)
        if still and last - newest >= _SILENCE_PERIODS:
            last = newest
        self.tally.window_end_ns = round(self.grid.time_of(last) + self.grid.period_ns / 2)
        for camera, track in self._tracks.items():
            if track.streaming:
                if track.silent:
                    self._outcomes.settle(camera, (newest if still else last) + 1, Fate.MISSING)
                self._outcomes.settle(camera, last + 1, Fate.SHUTDOWN)
            else:
                self._settle_unseen(camera, last + 1, last)
        self._resolve()

    def _waits_in_vain(self, track: _Track, now_ns: int) -> bool:
        """Whether a camera has taken triggers for so long without a first frame that there were none."""
        return track.ready_ns is not None and now_ns - track.ready_ns >= _SILENCE_PERIODS * self._period_ns

    def _arrival(self, camera: CameraName, frame_id: int, time_ns: int | None, outcome: Outcome) -> list[FrameSet]:
        track = self._tracks[camera]
        trigger = self._number(track, frame_id, time_ns)
        if trigger is None:
            return []
        if trigger < self._outcomes.settled[camera]:
            self.tally.surplus_frames += 1
            if frame_id > track.frame_id:
                track.frame_id += 1  # one of those since the last trigger's; the others were lost
            elif frame_id < track.frame_id - _REORDERED_FRAMES:
                track.frame_id = frame_id  # the camera counts from the beginning again
            if track.trigger < self._held_from:
                return self.silent(camera)  # all it sends is surplus: no frames that others could wait for
            return []
        self._explain_gap(camera, track, trigger, frame_id)
        self._outcomes.settle(camera, trigger + 1, outcome)
        patient_from = trigger - _PATIENCE_PERIODS
        if patient_from < track.resumed:
            patient_from -= track.stopped  # nobody waits for a camera while there are no triggers
        track.streaming, track.silent, track.frame_id, track.trigger = True, False, frame_id, trigger
        track.ready_ns = None
        if self.grid is not None and time_ns is not None:
            self.grid.observe(trigger, time_ns)
        for other_camera, other in self._tracks.items():
            if not other.streaming and other.gap_fate is Fate.GONE and other.ready_ns is None:
                self._outcomes.settle(other_camera, trigger - _HOLD_PERIODS, Fate.GONE)
            elif not other.streaming:
                self._settle_unseen(other_camera, trigger - _PATIENCE_PERIODS, trigger)
            elif other is not track:
                self._outcomes.settle(other_camera, patient_from, Fate.SILENT)
        return self._resolve() + self._release_lone()

    def _number(self, track: _Track, frame_id: int, time_ns: int | None) -> int | None:
        """The trigger of a frame, or None if unknown."""
        if track.streaming and (time_ns is None or self._numbered_by == "frame_id"):
            return track.trigger + max(frame_id - track.frame_id, 0)
        if time_ns is None:
            return None
        if self.grid is None:
            opened_ns = time_ns if self._opened_ns is None else self._opened_ns
            self._on_grid_ns = time_ns
            return self._open_grid(time_ns, max(int((time_ns - opened_ns) // self._period_ns), 0))
        if self.grid.off_phase(time_ns):
            if time_ns - self._on_grid_ns < _NEXT_PERIODS * self.grid.period_ns:
                return _SURPLUS
            self.grid.restart(time_ns)  # the trigger had stopped, and goes on
        self._on_grid_ns = max(self._on_grid_ns, time_ns)
        return self.grid.locate(time_ns)

    def _open_grid(self, time_ns: int, trigger: int) -> int:
        self.grid = TriggerGrid(self._period_ns, time_ns, trigger)
        self.tally.window_start_ns = round(self.grid.time_of(0) - self._period_ns / 2)
        return trigger

    def _explain_gap(self, camera: CameraName, track: _Track, trigger: int, frame_id: int) -> None:
        """Give every trigger between the camera's last frame and this one its fate."""
        if not track.streaming:
            self._settle_unseen(camera, trigger, trigger)
            track.not_given = 0
            return
        settled = self._outcomes.settled
        missing = min(max(frame_id - track.frame_id - 1, 0), trigger - settled[camera])
        not_given = min(track.not_given, trigger - settled[camera] - missing)
        not_taken = trigger - settled[camera] - missing - not_given
        fate = Fate.SILENT if not_taken >= _SILENCE_PERIODS else Fate.IGNORED
        missing_before = missing
        if fate is Fate.SILENT:
            track.resumed, track.stopped = trigger, not_taken
            stop = self._outcomes.first_silent_beside(camera)
            if stop is not None:  # the other frames were lost when the trigger went on
                missing_before = min(missing, max(stop - settled[camera], 0))
        self._outcomes.settle(camera, settled[camera] + missing_before, Fate.MISSING)
        track.not_given -= not_given
        self._outcomes.settle(camera, settled[camera] + not_given, Fate.NOT_GIVEN)
        self._outcomes.settle(camera, settled[camera] + not_taken, fate)
        self._outcomes.settle(camera, trigger, Fate.MISSING)

    def _settle_unseen(self, camera: CameraName, until: int, now: int) -> None:
        """Give triggers before a session's first frame their fate, `now` being the newest trigger known."""
        track = self._tracks[camera]
        if track.ready_ns is not None and self.grid is not None:
            ready = self.grid.last_before(track.ready_ns) + 1
            if now - ready >= _SILENCE_PERIODS:
                self._outcomes.settle(camera, min(ready, until), track.gap_fate)
                self._outcomes.settle(camera, until, Fate.SILENT)
        self._outcomes.settle(camera, until, track.gap_fate)

    def _resolve(self) -> list[FrameSet]:
        """Close the triggers whose outcome is known for every camera."""
        pairs: list[FrameSet] = []
        for trigger, count, outcomes in self._outcomes.close():
            frames = {camera: outcome for camera, outcome in outcomes.items() if isinstance(outcome, Frame)}
            if len(frames) == len(self._tracks) and self._of_one_instant(frames.values()):
                self.tally.pairs += 1
                self.tally.frames.update(list(frames))
                pairs.append(FrameSet(trigger, frames))
            elif not stopped(outcomes):
                self.tally.lost[loss_reason(outcomes)] += count
                for camera, outcome in outcomes.items():
                    arrived = isinstance(outcome, Frame) or outcome is Fate.TAKEN
                    (self.tally.frames if arrived else self.tally.frames_lost)[camera] += count
                pairs += self._partial(trigger, frames)
        return pairs

    @property
    def _held_from(self) -> int:
        """Frames from this trigger on wait for a partner."""
        return max(track.trigger for track in self._tracks.values()) - _HOLD_PERIODS

    def _release_lone(self) -> list[FrameSet]:
        """Frames that wait for a silent camera, handed out without its own; their trigger stays open."""
        sending = [camera for camera, track in self._tracks.items() if not track.silent]
        if len(sending) == len(self._tracks):
            return []
        held_from = self._held_from
        sets: list[FrameSet] = []
        settled = self._outcomes.settled
        known_to = sending or [max(settled, key=settled.__getitem__)]
        for trigger, runs in self._outcomes.waiting(self._lone_from, known_to):
            frames = {camera: run.outcome for camera, run in runs.items() if isinstance(run.outcome, Frame)}
            if sending:
                sets += self._partial(trigger, frames)
            if trigger < held_from:
                for run in runs.values():
                    run.outcome = Fate.TAKEN
        self._lone_from = max(self._lone_from, held_from)
        return sets

    def _of_one_instant(self, frames: Collection[Frame]) -> bool:
        times_ns = [frame.host_time_ns for frame in frames]
        return max(times_ns) - min(times_ns) < _INSTANT_PERIODS * self._period_ns

    def _partial(self, trigger: int, frames: Mapping[CameraName, Frame]) -> list[FrameSet]:
        """A set without all cameras: frames of one instant that were not handed out before, if there are any."""
        fresh = {camera: frame for camera, frame in frames.items() if trigger > self._tracks[camera].alone}
        first = next(iter(fresh.values()), None)
        alike = {camera: frame for camera, frame in fresh.items() if self._of_one_instant([first or frame, frame])}
        for camera in alike:
            self._tracks[camera].alone = trigger
        return [FrameSet(trigger, alike)] if alike else []
