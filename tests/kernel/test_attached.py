"""The kernel attaches the fake, stock libusb and stock Aravis drive it. `make test-kernel` runs this in its guest.

No real time: the guest's processor may be emulated.
"""

from __future__ import annotations

import contextlib
import re
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.aravis import AravisCamera, find_cameras, open_camera
from drivers.setup import CameraSetup, TriggerSetup
from fake_camera.device.faults import Fault
from imaging.errors import CameraLostError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from tests.fakes import FakeCamera
from tests.kernel.usbip import PATIENCE_S, Cable, camera_with_cable, output, wait_until

RATE_HZ = 5.0
FRAMES = 20
SILENCE_S = 5.0
DARK, BRIGHT = ExposureSetting(2000.0, 0.0), ExposureSetting(6000.0, 6.0)


@pytest.fixture(scope="module")
def plugged_in(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[FakeCamera, Cable]]:
    light = tmp_path_factory.mktemp("light") / "light.yaml"
    light.write_text("light: [{at_s: 0, lux: 50}]")
    with camera_with_cable(options=["--line0-rate-hz", str(RATE_HZ), "--light", str(light)]) as (camera, cable):
        cable.plug_in()
        yield camera, cable


@pytest.fixture
def fake(plugged_in: tuple[FakeCamera, Cable]) -> FakeCamera:
    return plugged_in[0]


@pytest.fixture
def cable(plugged_in: tuple[FakeCamera, Cable]) -> Cable:
    return plugged_in[1]


@contextlib.contextmanager
def streaming(fake: FakeCamera) -> Iterator[AravisCamera]:
    camera = open_camera(fake.serial, CameraSetup(TriggerSetup("external", rate_hz=RATE_HZ)))
    with contextlib.closing(camera):
        camera.start()
        yield camera


def next_frames(camera: AravisCamera, count: int) -> list[Frame]:
    """All of the next frames; each must be complete."""
    frames: list[Frame] = []
    while len(frames) < count:
        frame = camera.next_frame(PATIENCE_S)
        assert isinstance(frame, Frame), frame
        frames.append(frame)
    return frames


def frame_with(camera: AravisCamera, setting: ExposureSetting) -> Frame:
    """The first frame that was taken with this setting."""
    for _ in range(FRAMES):
        frame = next_frames(camera, 1)[0]
        if frame.setting == setting:
            return frame
    raise AssertionError(f"no frame was taken with {setting}")


def is_found(fake: FakeCamera) -> bool:
    return fake.serial in {camera.serial for camera in find_cameras()}


def test_the_kernel_enumerates_a_superspeed_camera(fake: FakeCamera) -> None:
    described = output("lsusb", "-v", "-d", "1209:0001")
    assert re.search(rf"iSerial +3 {fake.serial}$", described, re.MULTILINE)
    assert described.count("USB3 Vision") == 4  # three interfaces, and the function that they are
    assert "SuperSpeed USB Device Capability" in described
    assert "can't get" not in described
    folder = next(path.parent for path in Path("/sys/bus/usb/devices").glob("*/serial") if is_of(path, fake))
    assert (folder / "speed").read_text().strip() == "5000"


def is_of(serial: Path, fake: FakeCamera) -> bool:
    return serial.read_text().strip() == fake.serial


def test_arv_tool_lists_the_camera_and_writes_exposure_time_and_gain(fake: FakeCamera) -> None:
    assert re.search(rf"^Autoexpose-[0-9A-F]{{12}}-{fake.serial} \(USB3\)$", output("arv-tool-0.8"), re.MULTILINE)
    tool = ("arv-tool-0.8", "-n", f"Autoexpose-{fake.serial}", "control")
    output(*tool, "ExposureAuto=Off", "GainAuto=Off", "ExposureTime=4321", "Gain=6")
    read_back = output(*tool, "ExposureTime", "Gain")
    assert "ExposureTime = 4321 us" in read_back
    assert "Gain = 6 dB" in read_back


def test_frames_are_whole_and_in_order(fake: FakeCamera) -> None:
    with streaming(fake) as camera:
        frames = next_frames(camera, FRAMES)
    assert np.all(np.diff([frame.frame_id for frame in frames]) > 0)  # an emulated camera is late now and then
    assert {frame.pixels.shape for frame in frames} == {(540, 720)}


def test_exposure_time_and_gain_take_effect(fake: FakeCamera) -> None:
    with streaming(fake) as camera:
        levels = [frame_with(camera, camera.write(setting)).pixels.mean() for setting in (DARK, BRIGHT)]
    assert levels[1] > 2 * levels[0]


def test_a_second_program_is_told_that_the_camera_is_busy(fake: FakeCamera) -> None:
    read = ["arv-tool-0.8", "-n", f"Autoexpose-{fake.serial}", "control", "Width"]
    with streaming(fake) as camera:
        refused = subprocess.run(read, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        assert "Width" not in refused.stdout
        next_frames(camera, 2)
    wait_until(lambda: "Width = 720" in output(*read), "the camera to be free")


def test_a_host_that_has_the_camera_has_all_of_it(cable: Cable) -> None:
    with pytest.raises(AssertionError, match="usbip"):
        cable.plug_in()


def until_lost(camera: AravisCamera) -> None:
    """Take the frames that are still on their way."""
    with pytest.raises(CameraLostError):
        for _ in range(FRAMES):
            camera.next_frame(PATIENCE_S / FRAMES)


def test_a_streaming_camera_that_is_detached_is_lost_and_works_when_attached_again(
    fake: FakeCamera, cable: Cable
) -> None:
    with streaming(fake) as camera:
        next_frames(camera, 2)
        cable.unplug()
        until_lost(camera)
        assert not is_found(fake)
    cable.plug_in()
    wait_until(lambda: is_found(fake), "the camera")
    with streaming(fake) as camera:
        next_frames(camera, 5)


def test_a_camera_that_loses_power_is_gone_and_comes_back_in_power_on_state(fake: FakeCamera, cable: Cable) -> None:
    with streaming(fake) as camera:
        camera.write(BRIGHT)
        next_frames(camera, 2)
        fake.inject(Fault.VANISH, count=None)
        until_lost(camera)
    wait_until(lambda: cable.root_hub_port is None and not is_found(fake), "the kernel to let go of the camera")
    fake.inject(Fault.COME_BACK)
    cable.plug_in()
    wait_until(lambda: is_found(fake), "the camera")
    assert "ExposureAuto = Continuous" in output(
        "arv-tool-0.8", "-n", f"Autoexpose-{fake.serial}", "control", "ExposureAuto"
    )
    with streaming(fake) as camera:
        assert next_frames(camera, 5)[0].setting != BRIGHT


def test_a_stalled_stream_works_again_when_the_camera_is_opened_again(fake: FakeCamera) -> None:
    with streaming(fake) as camera:
        next_frames(camera, 2)
        fake.inject(Fault.STALL, count=1)
        assert any(camera.next_frame(SILENCE_S) is None for _ in range(FRAMES))
    with streaming(fake) as camera:
        next_frames(camera, 5)


def test_many_openings_leave_the_camera_usable(fake: FakeCamera) -> None:
    before = threading.active_count()
    for _ in range(5):
        with streaming(fake) as camera:
            next_frames(camera, 1)
    assert threading.active_count() == before
