"""Every shape of description that the survey has found, over the wire: driven, or refused for what it lacks."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.aravis import discovery, find_cameras, open_camera
from drivers.aravis.introspection import Aravis
from drivers.config.setup import CameraSetup, TriggerSetup
from drivers.errors import ConfigurationError, UnsupportedCameraError
from drivers.exposure import ExposureSetting
from drivers.frames import Frame
from drivers.pixels.formats import PixelFormat
from fake_camera.device.device import Device
from fake_camera.device.line0 import Line0
from fake_camera.genapi.description import Description
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.gige.server import GigeServer
from tests.drivers.aravis.grey_card import GreyCard, frames_until, grey_of
from tests.fakes import loopback_address, unique
from tests.xml_shapes import DRIVEN, FREE_ONLY, REFUSED, xml_shape

pytestmark = pytest.mark.wire

RATE_HZ = 50.0
FREELY = CameraSetup(TriggerSetup("free_run", rate_hz=RATE_HZ), PixelFormat.MONO8)
BY_LINE = CameraSetup(TriggerSetup("external", "Line1", RATE_HZ), PixelFormat.MONO8)


@dataclass(frozen=True)
class Shaped:
    serial: str
    device: Device


@pytest.fixture(scope="module")
def cameras() -> Iterator[dict[str, Shaped]]:
    line0 = Line0(time.monotonic_ns(), RATE_HZ)
    with contextlib.ExitStack() as running, pytest.MonkeyPatch.context() as patch:
        patch.setattr(discovery, "FRESH_S", float("inf"))
        shaped = {}
        for name in DRIVEN | FREE_ONLY | REFUSED:
            device = Device(GreyCard(), unique("SHP")[:15], 0, line0)
            running.callback(device.close)
            camera = XmlCamera(Description.from_bytes(xml_shape(name), name), device)
            assert camera.not_available == (), name
            server = GigeServer(device, loopback_address(), camera)
            server.start()
            running.callback(server.close)
            shaped[name] = Shaped(str(device.features.get("DeviceSerialNumber")), device)
        find_cameras()
        yield shaped


@pytest.mark.parametrize(("name", "setup"), [*((name, BY_LINE) for name in DRIVEN), *((n, FREELY) for n in FREE_ONLY)])
def test_the_image_follows_its_exposure(name: str, setup: CameraSetup, cameras: dict[str, Shaped]) -> None:
    with contextlib.closing(open_camera(cameras[name].serial, setup)) as camera:
        camera.start()
        gain_db = min(6.0, camera.limits.max_gain_db)
        for setting in (ExposureSetting(2000.0, 0.0), ExposureSetting(6000.0, 0.0), ExposureSetting(2000.0, gain_db)):
            taken = camera.write(setting)
            assert taken.agrees_with(setting)
            frames_until(camera, grey_of(taken))


@pytest.mark.realtime
@pytest.mark.parametrize("name", ["integers", "converter", "exposure start"])
def test_it_runs_freely_at_its_rate(name: str, cameras: dict[str, Shaped]) -> None:
    with contextlib.closing(open_camera(cameras[name].serial, FREELY)) as camera:
        camera.start()
        frames = [frame for _ in range(5) if isinstance(frame := camera.next_frame(0.5), Frame)]
        assert np.diff([frame.device_time_ns for frame in frames]) == pytest.approx(1e9 / RATE_HZ, rel=0.01)


@pytest.mark.parametrize(
    ("name", "setup", "words"),
    [
        ("no exposure", BY_LINE, "neither ExposureTime nor ExposureTimeAbs can be written"),
        ("a rate alone", FREELY, "neither ExposureTime nor ExposureTimeAbs can be written"),
        ("nothing", FREELY, "neither ExposureTime nor ExposureTimeAbs can be written"),
        ("no picture", BY_LINE, "it has no PixelFormat"),
        ("a time alone", BY_LINE, "no hardware trigger line, and no AcquisitionFrameRate to run freely at"),
        ("a time alone", FREELY, "no AcquisitionFrameRate to set"),
        ("sources alone", BY_LINE, "no hardware trigger line; run it with trigger mode free_run"),
        ("acquisition start", BY_LINE, "no FrameStart or ExposureStart trigger; .* offers AcquisitionStart"),
    ],
)
def test_it_is_refused_for_what_it_lacks(name: str, setup: CameraSetup, words: str, cameras: dict[str, Shaped]) -> None:
    with pytest.raises(UnsupportedCameraError, match=words):
        open_camera(cameras[name].serial, setup)


def test_a_rate_between_whole_numbers_is_refused_where_the_camera_takes_only_those(cameras: dict[str, Shaped]) -> None:
    setup = CameraSetup(TriggerSetup("free_run", rate_hz=49.6), PixelFormat.MONO8)
    with pytest.raises(ConfigurationError, match=r"whole numbers of Hz, such as 50, but not at 49\.6 Hz"):
        open_camera(cameras["integers"].serial, setup)


@pytest.mark.parametrize("name", DRIVEN | FREE_ONLY)
def test_stock_aravis_finds_the_time_writable_within_bounds(name: str, cameras: dict[str, Shaped]) -> None:
    device = Aravis.Camera.new(discovery.find_camera(cameras[name].serial).id).get_device()
    names = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
    name = next(name for name in names if device.get_feature(name) is not None)
    assert device.get_feature(name).get_actual_access_mode() == Aravis.GcAccessMode.RW
    is_float = isinstance(device.get_feature(name), Aravis.GcFloat)
    bounds = (device.get_float_feature_bounds if is_float else device.get_integer_feature_bounds)(name)
    assert 0 < bounds.min < bounds.max
