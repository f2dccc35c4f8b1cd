"""The record of a rig: what became of every trigger, and which write made which frame."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Literal

from drivers.camera import IncompleteFrame
from drivers.rig.events import (
    CameraGone,
    CameraReady,
    CameraSilent,
    Command,
    FrameArrived,
    NotTriggered,
    RigEvent,
    WriteFailed,
    Written,
)
from drivers.setup import TriggerMode
from drivers.triggers.account import TriggerAccount
from drivers.triggers.outcomes import Tally
from drivers.triggers.rate import StartCheck
from drivers.triggers.writes import GroupWrites, WriteHistory, WriteWindow
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet


class RigRecord:
    """Takes the events of a rig, in order, and returns sets of frames. Times are CLOCK_MONOTONIC, in ns.

    Cameras of one of `groups` (none: all) are exposed together. `trigger_sources` gives the TriggerSource of each
    camera that waits for triggers; without any, cameras run freely, and miss no trigger of their own. Triggers count
    from `opened_ns`, or in mode "ptp" from when the first camera is paced: `unpaced` are those that are open and will
    get scheduled triggers, but none yet.
    """

    def __init__(
        self,
        cameras: Sequence[CameraName],
        trigger_sources: Mapping[CameraName, str],
        rate_hz: float,
        opened_ns: int,
        mode: TriggerMode = "external",
        *,
        groups: Collection[Collection[CameraName]] = (),
    ) -> None:
        numbered_by: Literal["time", "frame_id"] = "time" if trigger_sources else "frame_id"
        self._scheduled = mode == "ptp"
        self.unpaced: set[CameraName] = set()
        self._account = TriggerAccount(cameras, 1e9 / rate_hz, None if self._scheduled else opened_ns, numbered_by)
        self._start_check = StartCheck(trigger_sources, rate_hz, by_host=mode in ("software", "ptp"))
        writes = [GroupWrites(group) for group in groups or [cameras]]
        self._writes = {camera: group for group in writes for camera in group.histories}
        self._window = WriteWindow()
        self._commands = 0

    @property
    def tally(self) -> Tally:
        """The account of triggers so far."""
        return self._account.tally

    @property
    def late_writes(self) -> int:
        """Settings that were written too late for the exposure they were for."""
        return sum(writes.late for writes in set(self._writes.values()))

    def history(self, camera: CameraName) -> WriteHistory:
        """The commands and writes of a camera."""
        return self._writes[camera].histories[camera]

    def begin(self, now_ns: int) -> None:
        """Count triggers from now on instead of from `opened_ns`, before the first event."""
        self._account.begin(now_ns)

    def take(self, event: RigEvent, now_ns: int) -> list[FrameSet]:
        """Enter any event but a write; returns the pairs that are ready for control, oldest first."""
        if isinstance(event, FrameArrived):
            self._start_check.frame(event.camera, event.frame.host_time_ns)
        match event:
            case FrameArrived(camera, IncompleteFrame() as frame):
                return self._account.incomplete(camera, frame)
            case FrameArrived(camera, Frame() as frame, stale=True):
                return self._account.stale(camera, frame)
            case FrameArrived(camera, Frame() as frame):
                return self._account.frame(camera, frame)
            case CameraSilent(camera):
                return self._account.silent(camera)
            case CameraGone(camera):
                self.unpaced.discard(camera)
                self._writes[camera].gone(camera)
                self._start_check.gone(camera)
                return self._account.gone(camera)
            case CameraReady(camera) if self._scheduled:
                self.unpaced.add(camera)
            case CameraReady(camera):
                self._ready(camera, now_ns)
            case WriteFailed(camera):
                self._writes[camera].refused(camera)
            case NotTriggered(camera, count):
                self._account.not_given(camera, count)
        return []

    def paced(self, camera: CameraName, now_ns: int) -> None:
        """The host triggers a camera from now on."""
        if camera in self.unpaced:
            self.unpaced.discard(camera)
            self._ready(camera, now_ns)

    def _ready(self, camera: CameraName, now_ns: int) -> None:
        self._start_check.ready(camera, now_ns)
        self._account.ready(camera, now_ns)

    def written(self, write: Written) -> Command | None:
        """Enter a write; returns the command behind it, None for the write when a camera is opened."""
        command = self._writes[write.camera].write(write, self._account.grid)
        if command is not None and not command.held:
            self._window.took(write.finished_ns - command.decided_ns)
        return command

    def command(
        self, setting: ExposureSetting, arrival_ns: int, decided_ns: int, cameras: Collection[CameraName] | None = None
    ) -> Command:
        """Enter a setting that was decided on for the cameras of a group (None: all); says when to write it."""
        grid = self._account.grid
        due_ns = decided_ns if grid is None else self._window.next_ns(grid, decided_ns)
        self._commands += 1
        concerned = tuple(self._writes if cameras is None else cameras)
        command = Command(self._commands, setting, arrival_ns, decided_ns, due_ns, concerned)
        self._writes[concerned[0]].command(command)
        return command

    def exposes_before_write(self, since_ns: int, decided_ns: int) -> bool:
        """Whether an exposure begins between `since_ns` and the write of a setting decided on at `decided_ns`."""
        grid = self._account.grid
        if grid is None:
            return True
        return grid.time_of(grid.last_before(self._window.next_ns(grid, decided_ns))) > since_ns

    def mismatched(self, pair: FrameSet) -> bool:
        """Whether settings within a group differ, or a frame was taken with one that no camera ever held completely."""
        return any(writes.mismatched(part) for writes, part in self._parts(pair))

    def explains_mismatch(self, pair: FrameSet) -> bool:
        """Whether it is known why a set is mismatched."""
        return all(writes.explains(part) for writes, part in self._parts(pair) if writes.mismatched(part))

    def _parts(self, pair: FrameSet) -> Iterator[tuple[GroupWrites, FrameSet]]:
        """What each group made of a set."""
        for writes in dict.fromkeys(self._writes[camera] for camera in pair.frames):
            part = pair.of(writes.histories)
            if part is not None:
                yield writes, part

    def findings(self, now_ns: int) -> list[str]:
        """What the first frames reveal about the wiring, each finding once."""
        return self._start_check.findings(now_ns)

    def close(self, now_ns: int) -> None:
        """Account for the triggers up to now that will never make a pair."""
        self._account.close(now_ns)
