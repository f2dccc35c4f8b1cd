"""Every shape of description that the survey has found, over the wire: driven, or refused for what it lacks.

Runs directly over GigE Vision; test_on_usb3.py runs some of it again in a process with the cameras on its USB bus.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.aravis import find_cameras, open_camera, opening
from drivers.setup import CameraSetup, TriggerSetup
from fake_camera.device.device import Device
from fake_camera.device.line0 import Line0
from fake_camera.genapi.description import Description
from fake_camera.genapi.xml_camera import XmlCamera
from imaging.errors import AutoexposeError, stays
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.pixels import PixelFormat
from tests.drivers.aravis.grey_card import NAME_SPACE, TRANSPORT, GreyCard, frames_until, grey_of, served
from tests.fakes import unique
from tests.xml_shapes import COUNTED, DRIVEN, FREE_ONLY, REFUSED, xml_shape

pytestmark = pytest.mark.wire

RATE_HZ = 50.0
FREELY = CameraSetup(TriggerSetup("free_run", rate_hz=RATE_HZ), PixelFormat.MONO8)
BETWEEN = CameraSetup(TriggerSetup("free_run", rate_hz=49.6), PixelFormat.MONO8)
BY_LINE = CameraSetup(TriggerSetup("external", "Line1", RATE_HZ), PixelFormat.MONO8)


ON_BOTH = ("fixed selectors", "automatic by numbers", "unknown counts", "no payload size")
"""Over USB3 Vision only these; the others do not concern the transport."""
SERVED = DRIVEN | COUNTED | FREE_ONLY | REFUSED if TRANSPORT == "gige" else ON_BOTH
UNABLE = ("boundless gain", "locked picture", "no bounds", "fixed rate", "increments of zero")
"""Of these the fake itself cannot make all features available, as they contradict themselves."""


def shape(name: str, *others: object) -> object:
    """A parameter of tests, and its marks."""
    return pytest.param(name, *others, marks=[] if name in ON_BOTH else pytest.mark.gige_only)


@dataclass(frozen=True)
class Shaped:
    serial: str
    device: Device
    camera: XmlCamera


@pytest.fixture(scope="module")
def cameras() -> Iterator[dict[str, Shaped]]:
    line0 = Line0(time.monotonic_ns(), RATE_HZ)
    with contextlib.ExitStack() as running, pytest.MonkeyPatch.context() as patch:
        patch.setattr(opening, "FRESH_S", float("inf"))
        shaped = {}
        for name in SERVED:
            device = Device(GreyCard(), unique("SHP")[:15], 0, line0)
            running.callback(device.close)
            camera = XmlCamera(Description.from_bytes(xml_shape(name, NAME_SPACE), name), device)
            assert camera.not_available == () or name in UNABLE, name
            running.enter_context(served(device, camera))
            shaped[name] = Shaped(str(device.features.get("DeviceSerialNumber")), device, camera)
        find_cameras()
        yield shaped


@pytest.mark.parametrize(
    ("name", "setup"), [*(shape(name, BY_LINE) for name in DRIVEN), *(shape(name, FREELY) for name in FREE_ONLY)]
)
def test_the_image_follows_its_exposure(name: str, setup: CameraSetup, cameras: dict[str, Shaped]) -> None:
    with contextlib.closing(open_camera(cameras[name].serial, setup)) as camera:
        camera.start()
        gain_db = min(6.0, camera.limits.max_gain_db)
        for setting in (ExposureSetting(2000.0, 0.0), ExposureSetting(6000.0, 0.0), ExposureSetting(2000.0, gain_db)):
            taken = camera.write(setting)
            assert taken.agrees_with(setting)
            frames_until(camera, grey_of(taken))


@pytest.mark.parametrize("name", [shape(name) for name in COUNTED])
def test_a_time_in_counts_is_driven_once_it_is_said_how_long_they_are(name: str, cameras: dict[str, Shaped]) -> None:
    with contextlib.closing(open_camera(cameras[name].serial, replace(BY_LINE, exposure_count_us=2.0))) as camera:
        camera.start()
        assert camera.write(ExposureSetting(4000.0, 6.0)) == ExposureSetting(4000.0, 6.0)
        frames_until(camera, grey_of(ExposureSetting(2000.0, 6.0)))  # 2000 of what the fake takes for microseconds


def test_what_a_read_only_selector_leaves_out_is_said_once(
    cameras: dict[str, Shaped], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    open_camera(cameras["fixed selectors"].serial, BY_LINE).close()
    fixed = [message for message in caplog.messages if "is read-only and stays at" in message]
    assert [message.split()[3] for message in fixed] == ["GainSelector", "TriggerSelector"]
    assert "ExposureStart" in fixed[1] and "ExposureActive" in fixed[1]


@pytest.mark.gige_only
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("boundless gain", r"gain \(Gain\) has no bounds"),
        ("locked picture", r"gain \(Gain\) cannot be written"),
        ("locked picture", "AcquisitionFrameRateEnable is True and cannot be False"),
        ("increments of zero", "calibrate gain --camera"),
    ],
)
def test_what_is_not_driven_is_named(name: str, words: str, cameras: dict[str, Shaped]) -> None:
    with contextlib.closing(open_camera(cameras[name].serial, BY_LINE)) as camera:
        assert re.search(words, " / ".join(camera.description.limitations))


@pytest.mark.gige_only
@pytest.mark.realtime
@pytest.mark.parametrize("name", ["integers", "converter", "exposure start"])
def test_it_runs_freely_at_its_rate(name: str, cameras: dict[str, Shaped]) -> None:
    with contextlib.closing(open_camera(cameras[name].serial, FREELY)) as camera:
        camera.start()
        frames = [frame for _ in range(5) if isinstance(frame := camera.next_frame(0.5), Frame)]
        assert np.median(np.diff([frame.device_time_ns for frame in frames])) == pytest.approx(1e9 / RATE_HZ, rel=0.01)


@pytest.mark.parametrize(
    ("name", "setup", "words"),
    [
        shape("no exposure", BY_LINE, "neither ExposureTime nor ExposureTimeAbs can be written"),
        shape("a rate alone", FREELY, "neither ExposureTime nor ExposureTimeAbs can be written"),
        shape("no picture", BY_LINE, "it has no PixelFormat"),
        shape("a time alone", BY_LINE, "no hardware trigger line, and no AcquisitionFrameRate to run freely at"),
        shape("a time alone", FREELY, "no AcquisitionFrameRate to set"),
        shape("sources alone", BY_LINE, "no hardware trigger line; run it with trigger mode free_run"),
        shape("acquisition start", BY_LINE, "no FrameStart or ExposureStart trigger; .* offers AcquisitionStart"),
        shape("unknown counts", BY_LINE, "ExposureTimeRaw counts in steps of unknown length: .* exposure_count_us"),
        shape("lines", BY_LINE, "ExposureTime is in 'lines', .* exposure_count_us"),
        shape("base", replace(BY_LINE, exposure_count_us=2.0), "ExposureTimeAbs is known: leave out exposure_count_us"),
        shape("fixed time", BY_LINE, "its ExposureTime cannot be written"),
        shape("no bounds", BY_LINE, "the bounds of node ExposureTime are not numbers"),
        shape("by the pulse", BY_LINE, "ExposureMode is TriggerWidth and cannot be Timed"),
        shape("always automatic", BY_LINE, "ExposureAuto has no Off, only Continuous"),
        shape("no payload size", BY_LINE, "it has no PayloadSize"),
        shape("no start", BY_LINE, "could not start acquisition: .*AcquisitionStart"),
        shape("integers", BETWEEN, r"whole numbers of Hz, such as 50, but not at 49\.6 Hz"),
        shape("fixed rate", FREELY, r"AcquisitionFrameRate is 25 Hz and cannot be written: set trigger\.rate_hz"),
    ],
)
def test_it_is_refused_for_what_it_lacks(name: str, setup: CameraSetup, words: str, cameras: dict[str, Shaped]) -> None:
    with pytest.raises(AutoexposeError, match=words) as refused, contextlib.ExitStack() as opened:
        camera = open_camera(cameras[name].serial, setup)
        opened.callback(camera.close)
        camera.start()
    assert stays(refused.value)


@pytest.mark.gige_only
def test_what_a_killed_client_left_locked_is_unlocked(cameras: dict[str, Shaped]) -> None:
    shaped = cameras["locked picture"]
    for name, number in (("TLParamsLocked", 1), ("PixelFormat", 0x01100007)):
        address = shaped.camera.address(name)
        assert address is not None
        shaped.camera.write(address, number.to_bytes(4, "big"))
    with contextlib.closing(open_camera(shaped.serial, BY_LINE)) as camera:
        assert camera.description.pixel_format == PixelFormat.MONO8


@pytest.mark.gige_only
@pytest.mark.filterwarnings("ignore:.*ARV_IS_GC")  # Aravis 0.8.26 when it has none
def test_what_is_no_description_is_not_tried_again() -> None:
    sound = Description.from_bytes(xml_shape("base"), "")
    device = Device(GreyCard(), unique("SHP")[:15], 0, Line0(time.monotonic_ns(), RATE_HZ))
    with contextlib.closing(device), served(device, XmlCamera(replace(sound, data=b"<?xml?><Other/>"), device)):
        serial = str(device.features.get("DeviceSerialNumber"))
        with pytest.raises(AutoexposeError, match=f"{serial}: its GenICam description cannot be read") as refused:
            open_camera(serial, BY_LINE)
        assert stays(refused.value)
