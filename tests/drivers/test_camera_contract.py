"""What every `Camera` must do, on stand-ins for real ones; aravis/test_camera_contract.py runs it over the wire."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Protocol

import pytest

from drivers.camera import Camera
from imaging.errors import CameraLostError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from tests.autoexpose_daemon.scripted import Session, TriggeredCamera
from tests.soak.camera import Device
from tests.soak.clock import MS, Clock

OLD, NEW = ExposureSetting(2000.0, 0.0), ExposureSetting(5000.0, 6.0)
MOST_PULSES = 600


class Bench(Protocol):
    """A camera opened for one test, never started, and its surroundings."""

    @property
    def camera(self) -> Camera:
        """The camera."""

    def pulse(self) -> None:
        """Trigger it, unless triggers run anyway, and let its frame arrive."""

    def vanish(self) -> None:
        """Take it away."""


def frames_until(bench: Bench, enough: Callable[[Frame], bool]) -> list[Frame]:
    """Complete frames up to the first that is `enough`."""
    frames: list[Frame] = []
    for _ in range(MOST_PULSES):
        bench.pulse()
        frame = bench.camera.next_frame(0.2)
        if isinstance(frame, Frame):
            frames.append(frame)
            if enough(frame):
                return frames
    raise AssertionError(f"none of {len(frames)} frames was the expected one")


def next_frames(bench: Bench, count: int) -> list[Frame]:
    numbers = iter(range(1, count + 1))
    return frames_until(bench, lambda _: next(numbers) == count)


class CameraContract:
    """For the tests of an implementation to inherit; they provide the fixture `bench`."""

    def test_it_describes_itself_and_its_limits(self, bench: Bench) -> None:
        description, limits = bench.camera.description, bench.camera.limits
        assert description.vendor and description.model and description.serial
        assert 0 < limits.min_time_us < limits.max_time_us
        assert limits.min_gain_db <= limits.max_gain_db
        assert limits.contain(OLD) and limits.contain(NEW)

    def test_frames_arrive_after_the_start(self, bench: Bench) -> None:
        assert bench.camera.next_frame(0.05) is None
        bench.camera.start()
        frames = next_frames(bench, 5)
        bench.camera.latch_clock()
        frames += next_frames(bench, 5)
        for frame in frames:
            assert frame.pixels.ndim == 2
            assert frame.pixels.dtype.itemsize == (frame.bit_depth + 7) // 8
        for before, after in itertools.pairwise(frames):
            assert before.frame_id < after.frame_id
            assert before.device_time_ns < after.device_time_ns
            assert before.host_time_ns < after.host_time_ns <= after.arrival_time_ns

    def test_a_write_is_read_back_and_shows_in_its_frames(self, bench: Bench) -> None:
        old = bench.camera.write(OLD)
        bench.camera.start()
        frames_until(bench, lambda frame: frame.setting == old)
        taken = bench.camera.write(NEW)
        assert taken.exposure_time_us == NEW.exposure_time_us
        assert taken.gain_db == pytest.approx(NEW.gain_db, abs=0.1)
        settings = [frame.setting for frame in frames_until(bench, lambda frame: frame.setting == taken)]
        settings += [frame.setting for frame in next_frames(bench, 5)]
        changed = next(index for index, setting in enumerate(settings) if setting != old)
        torn = settings[changed] if settings[changed] != taken else None
        assert torn in (None, ExposureSetting(taken.exposure_time_us, old.gain_db))
        assert set(settings[changed + 1 :]) == {taken}

    def test_closing_is_final_and_safe_twice(self, bench: Bench) -> None:
        bench.camera.start()
        next_frames(bench, 1)
        bench.camera.close()
        bench.camera.close()
        self._is_lost(bench.camera)

    def test_a_vanished_camera_is_lost_and_can_be_closed(self, bench: Bench) -> None:
        bench.camera.start()
        next_frames(bench, 1)
        bench.vanish()
        with pytest.raises(CameraLostError, match=bench.camera.description.serial):
            bench.camera.write(NEW)
        self._is_lost(bench.camera)
        bench.camera.close()
        self._is_lost(bench.camera)

    @staticmethod
    def _is_lost(camera: Camera) -> None:
        for call in (camera.start, camera.latch_clock, lambda: camera.write(OLD), lambda: camera.next_frame(0.05)):
            with pytest.raises(CameraLostError, match=camera.description.serial):
                call()


class VirtualBench:
    def __init__(self) -> None:
        self.device = Device("left", Clock(), seed=1)
        self.camera: Camera = self.device.open()
        self._pulses = 0

    def pulse(self) -> None:
        self._pulses += 1
        self.device.pulse(self._pulses, self.device.clock.now_ns)
        self.device.clock.now_ns += 50 * MS

    def vanish(self) -> None:
        self.device.vanish()


class ScriptedBench:
    def __init__(self) -> None:
        self.device = TriggeredCamera("L")
        self.camera: Camera = Session(self.device)

    def pulse(self) -> None:
        self.device.pulse(time.monotonic_ns())

    def vanish(self) -> None:
        self.device.lost = True


class TestVirtualCamera(CameraContract):
    @pytest.fixture
    def bench(self) -> VirtualBench:
        return VirtualBench()


class TestScriptedCamera(CameraContract):
    @pytest.fixture
    def bench(self) -> ScriptedBench:
        return ScriptedBench()
