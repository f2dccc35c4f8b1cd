"""One pair of another setting: from the request to the frames that show it."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future

from autoexpose_daemon.status.inputs.requests import Answer, Shot
from drivers.rig.events import CameraGone, RigEvent, WriteFailed, Written
from imaging.exposure import ExposureSetting
from imaging.frames import SIDES, Frame, Side, StereoPair

PATIENCE_NS = 1_000_000_000
PATIENCE_PERIODS = 8
"""A shot is given up if no frame shows it within the sum of these: the slowest camera reported takes 0.4 s."""

LONGEST_PATIENCE_NS = 8_000_000_000
"""The caller waits for 10 s."""


class PendingShot:
    """A shot that was asked for, and not yet seen.

    Parameters
    ----------
    setting
        What to take the pair with.
    deadline_ns
        When to give up.
    answer
        For the caller.

    Attributes
    ----------
    is_decided
        Whether the step that asks the cameras for it has been made.
    unwritten
        Cameras that are still to be written.
    written_ns
        When the last of the other cameras was written (CLOCK_MONOTONIC).
    """

    def __init__(self, setting: ExposureSetting, deadline_ns: int, answer: Future[Answer]) -> None:
        self.setting = setting
        self.deadline_ns = deadline_ns
        self.answer = answer
        self.is_decided = False
        self.unwritten: set[Side] = set()
        self.written_ns = 0
        self._cameras: set[Side] = set()
        self._seen: dict[Side, tuple[int, Frame]] = {}  # with the trigger

    def decided(self, written_to: Iterable[Side], present: Iterable[Side]) -> None:
        """The cameras that are present are asked for it; some of them will be written."""
        self.is_decided, self.unwritten, self._cameras = True, set(written_to), set(present)

    def see(self, event: RigEvent) -> None:
        """An event of the rig."""
        match event:
            case Written(side) if event.asked == self.setting:
                self.unwritten.discard(side)
                self.written_ns = event.finished_ns
            case WriteFailed(side):
                self.unwritten.discard(side)
            case CameraGone(side):
                self.unwritten.discard(side)
                self._cameras.discard(side)

    def is_in(self, pair: StereoPair) -> bool:
        """Whether a frame of a pair was taken for it: only the first such frame of each camera was."""
        if not self.is_decided:
            return False
        showing = {
            side: (pair.trigger, frame)
            for side, frame in pair.frames.items()
            if frame.setting.agrees_with(self.setting)
        }
        new = bool(showing.keys() - self._seen.keys())
        if new and showing.keys() >= self._cameras:  # regardless of frames of it seen alone before
            self._seen = showing
        elif new:
            self._seen = showing | self._seen
        return new

    def found(self) -> Shot | None:
        """The frames taken for it, once every camera that is still there has shown it.

        The trigger is the left frame's, if there is one: a camera that was written late shows it a frame later.
        """
        if not self._seen or not self._seen.keys() >= self._cameras:
            return None
        trigger, frame = self._seen[min(self._seen, key=SIDES.index)]
        return Shot(frame.setting, trigger, {side: frame.frame_id for side, (_, frame) in self._seen.items()})

    @property
    def shortfall(self) -> str:
        """Why it was not answered in time."""
        missing = " and ".join(sorted(self._cameras - self._seen.keys()))
        if not self._seen or not missing:  # nothing is missing once all cameras are gone
            return "no frame was taken with it in time: are there pairs, and does the camera take the setting?"
        return f"no frame of the {missing} camera was taken with it in time, or it was lost: ask again"
