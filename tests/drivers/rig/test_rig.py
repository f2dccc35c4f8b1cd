"""The rig's threads, on scripted cameras; the transports are covered by the contract tests."""

from __future__ import annotations

import itertools
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np

from drivers.camera import Camera, CameraDescription, RefusedPackets
from drivers.rig import Rig
from drivers.rig.events import CameraGone, CameraReady, Command, FrameArrived, RigEvent, WriteFailed, Written
from imaging.errors import CameraLostError, NodeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame

START = ExposureSetting(1000.0, 0.0)
LONG_S = 10.0
Event = TypeVar("Event", bound=RigEvent)


class ScriptedCamera:
    def __init__(self, shape: tuple[int, int] = (2, 2)) -> None:
        self.shape = shape
        self.description = CameraDescription("ours", "scripted", "S")
        self.limits = ExposureLimits(10.0, 1e4, 0.0, 30.0)
        self.frames: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self.written: list[ExposureSetting] = []
        self.lost = False
        self.refuses = False
        self.closed = threading.Event()
        self._ids = itertools.count(1)

    def start(self) -> None:
        self._check()

    def next_frame(self, timeout_s: float) -> Frame | None:
        self._check()
        try:
            return self.frames.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        self._check()
        if self.refuses:
            raise NodeError("camera S: ExposureTime refused")
        self.written.append(setting)
        return setting

    def trigger(self) -> None:
        raise NotImplementedError

    def schedule(self, device_time_ns: int) -> None:
        raise NotImplementedError

    def latch_clock(self) -> None:
        self._check()

    def temperature_c(self) -> float | None:
        return None

    def refused_packets(self) -> RefusedPackets | None:
        return None

    def close(self) -> None:
        self.closed.set()

    def expose(self) -> None:
        now_ns = time.monotonic_ns()
        self.frames.put(Frame(np.zeros(self.shape, np.uint8), 8, next(self._ids), now_ns, now_ns, now_ns, START))

    def _check(self) -> None:
        if self.lost:
            raise CameraLostError(f"camera {self.description.serial} does not answer")


@contextmanager
def running(openers: dict[CameraName, Callable[[], Camera]], silence_s: float = LONG_S) -> Iterator[Rig]:
    rig = Rig(openers, silence_s, dict.fromkeys(openers, START))
    rig.start()
    try:
        yield rig
    finally:
        assert rig.stop(LONG_S)


def command(number: int, exposure_time_us: float, due_ns: int = 0, *cameras: CameraName) -> Command:
    return Command(number, ExposureSetting(exposure_time_us, 0.0), 0, 0, due_ns, cameras or ("left",))


def wait_for(rig: Rig, kind: type[Event]) -> Event:
    deadline = time.monotonic() + LONG_S
    while True:
        event = rig.events.get(timeout=deadline - time.monotonic())
        if isinstance(event, kind):
            return event


def test_a_camera_starts_with_the_start_setting_and_delivers_frames() -> None:
    camera = ScriptedCamera()
    with running({"left": lambda: camera}) as rig:
        assert wait_for(rig, Written).read_back == START
        assert wait_for(rig, CameraReady).limits == camera.limits
        camera.expose()
        assert wait_for(rig, FrameArrived).frame.frame_id == 1
    assert camera.closed.is_set()


def test_only_the_latest_waiting_setting_is_written_and_not_early() -> None:
    camera = ScriptedCamera()
    with running({"left": lambda: camera}) as rig:
        wait_for(rig, CameraReady)
        not_before_ns = time.monotonic_ns() + 100_000_000
        rig.write(command(1, 2000.0, not_before_ns))
        rig.write(command(2, 3000.0, not_before_ns))
        written = wait_for(rig, Written)
        assert written.asked.exposure_time_us == 3000.0
        assert written.started_ns >= not_before_ns
    assert [setting.exposure_time_us for setting in camera.written] == [1000.0, 3000.0]


def test_a_lost_camera_is_reopened_with_the_last_wanted_setting_and_does_not_disturb_the_other() -> None:
    left, fresh, right = ScriptedCamera(), ScriptedCamera(), ScriptedCamera()
    lefts = iter([left, fresh])
    with running({"left": lambda: next(lefts), "right": lambda: right}, silence_s=0.05) as rig:
        wait_for(rig, CameraReady)
        wait_for(rig, CameraReady)
        rig.write(command(3, 4000.0, 0, "left", "right"))
        while left.written[-1].exposure_time_us != 4000.0:
            wait_for(rig, Written)
        left.lost = True
        assert wait_for(rig, CameraGone).camera == "left"
        assert wait_for(rig, CameraReady).camera == "left"
        right.expose()
        assert wait_for(rig, FrameArrived).camera == "right"
    assert left.closed.is_set()
    assert fresh.written[0].exposure_time_us == 4000.0
    assert len(right.written) == 2


def test_a_refused_write_is_reported_and_the_camera_kept() -> None:
    camera = ScriptedCamera()
    with running({"left": lambda: camera}) as rig:
        wait_for(rig, CameraReady)
        camera.refuses = True
        rig.write(command(4, 2000.0, 0))
        assert "ExposureTime" in str(wait_for(rig, WriteFailed).error)
        camera.refuses = False
        rig.write(command(5, 2500.0, 0))
        assert wait_for(rig, Written).asked.exposure_time_us == 2500.0


def test_frames_that_nobody_takes_are_marked_stale_and_drop_their_pixels() -> None:
    camera = ScriptedCamera()
    with running({"left": lambda: camera}) as rig:
        wait_for(rig, CameraReady)
        for _ in range(40):
            camera.expose()
        while rig.events.qsize() < 40:
            time.sleep(0)
        stale, kept_bytes = [], []
        while not rig.events.empty():
            event = rig.events.get_nowait()
            if isinstance(event, FrameArrived):
                stale.append(event.stale)
                assert isinstance(event.frame, Frame)
                kept_bytes.append(event.frame.pixels.nbytes)
    assert not stale[0]
    assert stale[-1]
    assert [kept == 0 for kept in kept_bytes] == stale


def test_a_hanging_camera_does_not_keep_the_process_alive() -> None:
    with running({"left": ScriptedCamera, "right": ScriptedCamera}):
        threads = {thread.name: thread.daemon for thread in threading.enumerate()}
        assert [threads[f"{work}-{camera}"] for work in ("nodes", "frames") for camera in ("left", "right")] == [
            True
        ] * 4
