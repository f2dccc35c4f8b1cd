"""A daemon on cameras that do as they are told: for what comes after the cameras, without a transport."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from autoexpose_daemon.config.document import CameraConfig, Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.recording.recorder import Recorder
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.service import add_outlets
from drivers.camera import Camera
from imaging.errors import CameraLostError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.pixels import PixelFormat
from tests.autoexpose_daemon.control.scene import expose, radiance
from tests.drivers.rig.test_rig import ScriptedCamera
from tests.meanwhile import meanwhile

SHAPE = (136, 180)
MID_LEVEL = 10.0
"""Exposure level at which the picture is half of full scale."""
RATE_HZ = 30.0
"""Half of the usual: four of these at once leave a machine with two cores room to keep up."""

LONG_S = 30.0
Seen = list[tuple[FrameSet, Decision | None]]


class TriggeredCamera(ScriptedCamera):
    """Takes each trigger with what was last written; a picture of patches and of noise."""

    def __init__(self, serial: str) -> None:
        super().__init__(SHAPE)
        self.description = type(self.description)(
            "ours", "scripted", serial, pixel_format=PixelFormat.MONO8, size=SHAPE[::-1]
        )
        self.starts = 0
        self._scene = radiance(ord(serial))
        self._noise = np.random.default_rng(ord(serial))

    def start(self) -> None:
        super().start()
        self.starts += 1
        while not self.frames.empty():  # of the time when it was not open
            self.frames.get()

    def pulse(self, time_ns: int) -> None:
        setting = self.written[-1] if self.written else ExposureSetting(1000.0, 0.0)
        pixels = expose(self._scene, setting, MID_LEVEL).pixels.astype(np.uint8)
        pixels ^= self._noise.integers(0, 4, pixels.shape, np.uint8)
        frame_id = next(self._ids)
        self.frames.put(Frame(pixels, 8, frame_id, time_ns, time_ns, time.monotonic_ns(), setting))


class Session:
    """A scripted camera while it is open (see `drivers.camera.Camera`): closed for good, while the camera may go on."""

    def __init__(self, camera: ScriptedCamera) -> None:
        self.description, self.limits = camera.description, camera.limits
        self._camera = camera
        self._closed = False

    def start(self) -> None:
        self._open().start()

    def next_frame(self, timeout_s: float) -> Frame | None:
        return self._open().next_frame(timeout_s)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        return self._open().write(setting)

    def trigger(self) -> None:
        raise AssertionError("a camera that the host does not trigger")

    def schedule(self, device_time_ns: int) -> None:
        raise AssertionError("a camera that the host does not trigger")

    def latch_clock(self) -> None:
        self._open().latch_clock()

    def temperature_c(self) -> None:
        pass

    def refused_packets(self) -> None:
        pass

    def close(self) -> None:
        self._closed = True

    def _open(self) -> ScriptedCamera:
        if self._closed:
            raise CameraLostError(f"camera {self.description.serial} is closed")
        return self._camera


class ScriptedRig:
    """The cameras of a configuration on one trigger, while the context lasts and unless it `pauses`."""

    def __init__(self, cameras: Mapping[CameraName, CameraConfig]) -> None:
        self._cameras = {name: TriggeredCamera(camera.serial) for name, camera in cameras.items()}
        self.pauses = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._pulse)

    def __getitem__(self, camera: CameraName) -> TriggeredCamera:
        return self._cameras[camera]

    @property
    def left(self) -> TriggeredCamera:
        return self["left"]

    @property
    def right(self) -> TriggeredCamera:
        return self["right"]

    @property
    def openers(self) -> dict[CameraName, Callable[[], Camera]]:
        return {name: partial(Session, camera) for name, camera in self._cameras.items()}

    def __enter__(self) -> ScriptedRig:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _pulse(self) -> None:
        start_ns = time.monotonic_ns()
        for number in itertools.count(1):
            time_ns = start_ns + round(number * 1e9 / RATE_HZ)
            if self._stop.wait(max(time_ns - time.monotonic_ns(), 0) * 1e-9):
                return
            for camera in () if self.pauses else self._cameras.values():
                camera.pulse(time_ns)


PAIR = {"left": {"serial": "L"}, "right": {"serial": "R"}}
FRONT_AND_REAR = {
    "front_left": {"serial": "A", "group": "front"},
    "front_right": {"serial": "B", "group": "front"},
    "rear": {"serial": "C", "group": "rear"},
}
"""Sections `cameras` of a configuration; serials have a single letter, by which pictures differ."""


def config(**sections: Any) -> Config:
    return Config.model_validate({"cameras": PAIR, "trigger": {"rate_hz": RATE_HZ}, **sections})


@contextlib.contextmanager
def scripted_daemon(recorder: Recorder | None = None, **sections: Any) -> Iterator[tuple[Daemon, ScriptedRig, Seen]]:
    """A daemon at work with these sections of its configuration, and all that its control sees."""
    seen: Seen = []
    configuration = config(**sections)
    with ScriptedRig(configuration.cameras) as rig:
        daemon = Daemon(configuration, rig.openers, outlets=[lambda step: seen.append((step.pair, step.decision))])
        add_outlets(daemon, configuration, recorder)
        with meanwhile(daemon.run):
            yield daemon, rig, seen
