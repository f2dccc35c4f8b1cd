"""Every pixel format over the wire: from a fake camera through stock Aravis to our driver, bit by bit.

Runs directly over GigE Vision; test_on_usb3.py runs it again in a process with the cameras on its USB bus.
"""

from __future__ import annotations

import contextlib
import gc
import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from drivers.aravis import open_camera, opening
from drivers.aravis.nodes import Aravis
from drivers.camera import IncompleteFrame
from drivers.genicam.image_format import decode_pixels
from drivers.setup import CameraSetup, TriggerSetup
from fake_camera.device.device import Device
from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame, ImageSettings, Pixels
from imaging.frames import Frame
from imaging.pixels import PixelFormat
from tests.drivers.aravis.grey_card import served
from tests.fake_camera.stock_aravis import next_buffer
from tests.fakes import unique
from tests.meanwhile import wait_until

pytestmark = pytest.mark.wire

RATE_HZ = 100.0


class Noise:
    """In each format the same noise in every frame, over all of its range."""

    sensor_width, sensor_height = 64, 48

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        sent = PIXEL_FORMATS[settings.pixel_format]
        shape = sent.shape(settings.width, settings.height)
        noise = np.random.default_rng(sent.pfnc_code).integers(0, sent.max_grey, shape, endpoint=True)
        return noise.astype(sent.dtype)

    def lux(self, time_s: float) -> float:
        return 1.0


def expected(device: Device, name: str) -> Pixels:
    return Noise().take(0.0, replace(device.features.image_settings(1 << 62), pixel_format=name), 0)


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    serial = unique("PIX")[:15]
    with contextlib.ExitStack() as running, pytest.MonkeyPatch.context() as patch:
        patch.setattr(opening, "FRESH_S", float("inf"))  # one search for all
        device = Device(Noise(), serial)
        running.callback(device.close)
        running.enter_context(served(device))
        yield device
        gc.collect()  # Aravis says goodbye when it frees a camera, and waits for the answer


def serial_of(device: Device) -> str:
    return str(device.features.get("DeviceSerialNumber"))


@pytest.mark.realtime
def test_every_format_arrives_bit_by_bit(device: Device) -> None:
    """On one open camera, set up again for each: opening takes a quarter of a second over USB.

    Alone, as all streams of bare Aravis: without our filter a packet from another test's camera may end the process.
    """
    camera = Aravis.Camera.new(opening.find_camera(serial_of(device)).id)
    camera.set_exposure_time_auto(Aravis.Auto.OFF)
    camera.set_exposure_time(100.0)
    for wanted in PixelFormat:
        camera.get_device().set_string_feature_value("PixelFormat", wanted.value)
        stream = camera.create_stream(None, None)
        stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
        camera.start_acquisition()
        buffer = next_buffer(stream)
        says = buffer.get_image_pixel_format(), buffer.get_image_width(), buffer.get_image_height()
        pixels = decode_pixels(buffer.get_data(), *says, wanted)
        assert np.array_equal(pixels, expected(device, wanted)), wanted
        del buffer, stream  # while frames come: on USB its thread would wait 0.2 s for one
        camera.stop_acquisition()


@pytest.mark.parametrize(
    "wanted", [PixelFormat.MONO10_PACKED, PixelFormat.BAYER_RG12P, PixelFormat.RGB8, PixelFormat.YUV422_8]
)
def test_the_driver_opens_a_camera_in_it(device: Device, wanted: PixelFormat) -> None:
    """With chunk data behind the image."""
    frame = next_frame(device, wanted)
    assert isinstance(frame, Frame)
    assert (frame.bit_depth, frame.layout, frame.setting_source) == (wanted.bit_depth, wanted.layout, "chunk")
    assert np.array_equal(frame.pixels, expected(device, wanted))
    assert wanted.layout == "grey" or device.features.get("BalanceWhiteAuto") == "Off"


def test_frames_that_lie_about_their_mosaic_are_refused_by_name(
    device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    send = device._sink

    def lie(frame: ExposedFrame) -> None:
        send(replace(frame, settings=replace(frame.settings, pixel_format="BayerGB8")))

    device.connect(lie)
    try:
        with caplog.at_level(logging.WARNING):
            frame = next_frame(device, PixelFormat.BAYER_RG8)
    finally:
        device.connect(send)
    assert isinstance(frame, IncompleteFrame)
    (said,) = caplog.messages
    for words in (f"camera {serial_of(device)}", f"the first is {frame.frame_id}", "BayerGB8", "set to BayerRG8"):
        assert words in said


def next_frame(device: Device, wanted: PixelFormat) -> Frame | IncompleteFrame:
    setup = CameraSetup(TriggerSetup("free_run", rate_hz=RATE_HZ), pixel_format=wanted)
    with contextlib.closing(open_camera(serial_of(device), setup)) as camera:
        camera.start()
        return wait_until(lambda: camera.next_frame(0.2))
