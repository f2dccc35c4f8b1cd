"""Recorders: take the steps of control without ever delaying it, and write them on their own thread."""

from __future__ import annotations

import logging
import math
import os
import queue
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Plain
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.messages.frames import Stamping
from autoexpose_daemon.recording.file import RecordingError, RecordingFile, Step
from drivers.log_throttle import LogThrottle
from imaging.frames import CameraName
from imaging.geometry import CameraGeometry
from imaging.python310 import Self

log = logging.getLogger(__name__)

SUFFIX = ".mcap"
SNAPSHOT_S = 1.0
"""Seconds' worth of steps between snapshots of the loop's state: a replay can begin at each."""

QUEUE_S = 2.0
"""Seconds of steps that may wait for the disk, 95 MB of 720x540 at 60 Hz: writing its cache stalls it for 1 s."""

_LOOK_S = 0.1
_SAID_S = 10.0  # a disk that is a little too slow drops a step here and there


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A step, how its messages are stamped, the setup of its loop, the state after it if due, and when it was taken."""

    step: Step
    setup: ControlSetup
    state: Plain
    taken_ns: int
    stamping: Stamping


class Recorder(ABC):
    """Takes the steps of daemons, and writes them in the background while its context is open.

    `rate_hz` are steps per second, for `room_s` of which there is room; `frames` says how frames are stamped.
    """

    def __init__(self, rate_hz: float, room_s: float, frames: PublishConfig) -> None:
        self.steps = 0  # of control, to be recorded
        self.dropped = 0  # steps among them for which there was no room
        self.failure: str | None = None  # what is wrong with the recording, in a sentence; None: nothing
        self.incomplete = False  # whether something that should be recorded is not: for the exit code
        self._ended = False
        self._room_s = room_s
        self._room = 0
        self.follow(rate_hz, frames)
        self._queue: queue.SimpleQueue[Entry | None] = queue.SimpleQueue()  # its `put` never waits; None: the end
        self._dropped_said = 0
        self._throttle = LogThrottle(_SAID_S)
        self._setup: ControlSetup | None = None
        self._snapshot_step = 0
        self._thread = threading.Thread(target=self._run, name="recorder")

    def follow(self, rate_hz: float, frames: PublishConfig) -> None:
        """Steps come at this rate from now on, of frames stamped like this; while no control thread runs."""
        self._steps_per_snapshot = math.ceil(SNAPSHOT_S * rate_hz)
        self._room = max(self._room, math.ceil(self._room_s * rate_hz))  # what is kept was taken at the rate before
        self._frames = frames

    def of(self, _group: str) -> Recorder | None:
        """That of a group of cameras: itself, since there is no other group."""
        return self

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Write what is left, and end."""
        self._queue.put(None)
        self._thread.join()

    def take(
        self, made: ControlStep, loop: ControlLoop, cameras: int, calibrations: Mapping[CameraName, CameraGeometry]
    ) -> None:
        """Take a step of a rig with this many cameras; on the control thread, right after `loop` has made it."""
        if self._ended:
            return
        self.steps += 1
        if self._queue.qsize() >= self._room:
            self.dropped += 1
            self._setup = None  # take a snapshot with the next step, so a replay can continue from there
            return
        now_ns, state = time.monotonic_ns(), None
        if self.dropped > self._dropped_said and self._throttle.due("dropped", now_ns):
            log.warning("the recorder dropped %d steps: the disk did not keep up", self.dropped - self._dropped_said)
            self._dropped_said = self.dropped
        if loop.setup is not self._setup or self.steps - self._snapshot_step >= self._steps_per_snapshot:
            self._setup, self._snapshot_step, state = loop.setup, self.steps, loop.state()
        assert made.decision is not None, "a pair without a decision is no step"
        step = Step(self.steps, cameras, made.inputs, made.decision, made.requests, calibrations)
        self._queue.put(Entry(step, loop.setup, state, now_ns, self._frames.stamping))

    @abstractmethod
    def save(self) -> None:
        """Write what is in memory, in the background; a signal handler may call this."""

    @property
    @abstractmethod
    def summary(self) -> str:
        """What was recorded, in one line."""

    @abstractmethod
    def _run(self) -> None:
        """Take entries from the queue until its end, and write."""


class ContinuousRecorder(Recorder):
    """Writes all steps to one file, which must not exist yet; raises RecordingError when it cannot be written."""

    def __init__(self, file: Path, rate_hz: float, frames: PublishConfig) -> None:
        super().__init__(rate_hz, QUEUE_S, frames)
        self._path = file
        self._file = RecordingFile(file, frames.rig)

    def save(self) -> None:
        """Nothing: everything is written anyway."""

    @property
    def summary(self) -> str:
        """Steps that can be read back, drops, and what was lost to a failure."""
        lost = self.steps - self.dropped - self._file.steps
        return (
            f"{self._path}: {self._file.steps} steps recorded, {self.dropped} dropped by the recorder"
            f"{f', {lost} lost when it stopped' if lost else ''}"
        )

    def _run(self) -> None:
        try:
            while (entry := self._queue.get()) is not None:
                self._file.write(entry.step, entry.setup, entry.state, entry.stamping)
        except RecordingError as error:
            self._end(error)
        try:
            self._file.close(self.steps, self.dropped)
        except RecordingError as error:
            self._end(error)

    def _end(self, error: RecordingError) -> None:
        if self._ended:
            return
        self._ended = self.incomplete = True
        self.failure = str(error)
        log.warning("recording stops, control goes on: %s", error)
        self._queue = queue.SimpleQueue()


class LastSecondsRecorder(Recorder):
    """Keeps the last seconds in memory, and writes them when asked to, and at the end: ``run-1.mcap``, ``run-2.mcap``.

    `file` is ``run.mcap``; the next free number is used. The `last_s` seconds are up to one more, so that a recording
    begins with a snapshot; memory is limited to them, and twice that while it writes. Raises RecordingError when the
    folder does not exist.
    """

    def __init__(self, file: Path, rate_hz: float, frames: PublishConfig, last_s: float) -> None:
        super().__init__(rate_hz, last_s + SNAPSHOT_S, frames)
        self._ring: deque[Entry] = deque()
        if not os.access(file.absolute().parent, os.W_OK):
            raise RecordingError(f"{file}: cannot be written; name a file in an existing folder")
        self._path = file
        self._last_s = last_s
        self._save_asked = False
        self._written: list[str] = []

    def save(self) -> None:
        """Write the last seconds in the background."""
        self._save_asked = True

    @property
    def summary(self) -> str:
        """The files, each with the steps that can be read back."""
        return f"recordings written: {', '.join(self._written) or 'none'}"

    def _run(self) -> None:
        closing = False
        while not closing:
            with suppress(queue.Empty):  # a signal handler wakes no thread, so look now and then
                entry = self._queue.get(timeout=_LOOK_S)
                closing = entry is None
                if entry is not None:
                    self._ring.append(entry)
                    while len(self._ring) > self._room + 1:
                        self._ring.popleft()
            # Steps that came while the file before was written are among the last seconds, too.
            if closing or (self._save_asked and self._queue.empty()):
                self._save_asked = False
                self._write(last_seconds(list(self._ring), self._last_s))

    def _write(self, entries: Sequence[Entry]) -> None:
        if not entries:
            return
        try:
            path = self._free_path()
            file = RecordingFile(path, self._frames.rig)
        except RecordingError as error:
            self._fell_short("nothing is saved", error)
            return
        self.failure = None
        try:
            for entry in entries:
                file.write(entry.step, entry.setup, entry.state, entry.stamping)
        except RecordingError as error:
            self._fell_short("not all is saved", error)
        try:
            file.close(len(entries), 0)
        except RecordingError as error:
            if self.failure is None:
                self._fell_short("not all is saved", error)
        saved = f"{file.steps} steps" if file.steps == len(entries) else f"{file.steps} of {len(entries)} steps"
        self._written.append(f"{path} ({saved})")
        log.info("%s: the last %s saved", path, saved)

    def _fell_short(self, how: str, error: RecordingError) -> None:
        self.incomplete = True
        self.failure = str(error)
        log.warning("%s, control goes on: %s", how, error)

    def _free_path(self) -> Path:
        number = 1
        try:
            while (path := self._path.with_stem(f"{self._path.stem}-{number}")).exists():
                number += 1
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be written: {error.strerror}") from error
        return path


class GroupRecorders:
    """The recorders of groups of cameras, each with a file of its own, as one."""

    def __init__(self, recorders: Mapping[str, Recorder]) -> None:
        self._recorders = recorders
        self._open = ExitStack()

    def of(self, group: str) -> Recorder | None:
        """That of a group; None for one that the rig got by a reload."""
        return self._recorders.get(group)

    def follow(self, rate_hz: float, frames: PublishConfig) -> None:
        """See `Recorder.follow`."""
        for recorder in self._recorders.values():
            recorder.follow(rate_hz, frames)

    def save(self) -> None:
        """See `Recorder.save`."""
        for recorder in self._recorders.values():
            recorder.save()

    @property
    def steps(self) -> int:
        """Of all groups, to be recorded."""
        return sum(recorder.steps for recorder in self._recorders.values())

    @property
    def dropped(self) -> int:
        """Steps among them for which there was no room."""
        return sum(recorder.dropped for recorder in self._recorders.values())

    @property
    def failure(self) -> str | None:
        """What is wrong with a recording, in a sentence; None: nothing."""
        return next((recorder.failure for recorder in self._recorders.values() if recorder.failure), None)

    @property
    def incomplete(self) -> bool:
        """Whether something that should be recorded is not."""
        return any(recorder.incomplete for recorder in self._recorders.values())

    @property
    def summary(self) -> str:
        """What was recorded, a line for each."""
        return "\n".join(recorder.summary for recorder in self._recorders.values())

    def __enter__(self) -> Self:
        for recorder in self._recorders.values():
            self._open.enter_context(recorder)
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()


def new_recorder(file: Path, config: Config, last_s: float | None) -> Recorder | GroupRecorders:
    """A recorder for a file: of the last seconds on demand, or of everything when `last_s` is None.

    Groups of cameras are recorded apart: for ``run.mcap`` in ``run.front.mcap`` and so on.

    Raises RecordingError when the file cannot be written, or its name is not that of a recording.
    """
    if file.suffix != SUFFIX:
        raise RecordingError(f"{file}: is not a name for a recording: it must end in {SUFFIX}")
    groups = config.cameras_of_groups
    if len(groups) == 1:
        return _new_recorder(file, config, last_s)
    files = {group: file.with_stem(f"{file.stem}.{group}") for group in groups}
    return GroupRecorders({group: _new_recorder(each, config, last_s) for group, each in files.items()})


def _new_recorder(file: Path, config: Config, last_s: float | None) -> Recorder:
    rate_hz, frames = config.trigger.rate_hz, config.publish or PublishConfig()
    if last_s is None:
        return ContinuousRecorder(file, rate_hz, frames)
    return LastSecondsRecorder(file, rate_hz, frames, last_s)


def last_seconds(entries: Sequence[Entry], last_s: float) -> Sequence[Entry]:
    """The entries of the last seconds, and those before them back to a snapshot."""
    if not entries:
        return entries
    begin_ns = entries[-1].taken_ns - last_s * 1e9
    snapshots = [index for index, entry in enumerate(entries) if entry.state is not None]
    before = [index for index in snapshots if entries[index].taken_ns <= begin_ns]
    return entries[max(before) if before else min(snapshots, default=0) :]
