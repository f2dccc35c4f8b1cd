"""An Image in CDR becomes a CompressedImage in CDR."""

from __future__ import annotations

import threading
from typing import Any

import cv2
import numpy as np
import pytest
from autoexpose_ros.jpeg import Compression, JpegThread, UnreadableError, compressed

from autoexpose_daemon.messages.frames import MessageWriter, Stamping
from autoexpose_daemon.messages.types import TYPESTORE
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.pixels import Layout, Pixels

COMPRESSED = "sensor_msgs/msg/CompressedImage"
STAMP_NS = 1_700_000_000_123_456_789


def image(pixels: Pixels, layout: Layout = "grey", bit_depth: int = 8) -> bytes:
    frame = Frame(pixels, bit_depth, 1, 0, 0, 0, ExposureSetting(1000.0, 0.0), layout=layout)
    writer = MessageWriter("rig", 1, Stamping("start"))
    (message,) = writer.messages(FrameSet(1, {"left": frame}), {}, 0, STAMP_NS, {("left", "image")})
    return bytes(message.data)


def read(cdr: bytes) -> tuple[Any, Pixels]:
    message = TYPESTORE.deserialize_cdr(cdr, COMPRESSED)
    return message, np.asarray(cv2.imdecode(message.data, cv2.IMREAD_UNCHANGED))


def test_grey_stays_grey_with_its_header() -> None:
    pixels = np.full((54, 72), 100, np.uint8)
    message, picture = read(compressed(image(pixels), 90))
    assert message.header.frame_id == "rig_left_optical_frame"
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP_NS
    assert message.format == "mono8; jpeg compressed mono8"
    assert np.abs(picture.astype(int) - 100).max() <= 2


@pytest.mark.parametrize("layout", ["RGGB", "GRBG", "GBRG", "BGGR"])
def test_a_mosaic_becomes_colour(layout: Layout) -> None:
    """Red light: only the red samples are bright."""
    pixels = np.zeros((64, 64), np.uint8)
    place = layout.index("R")
    pixels[place // 2 :: 2, place % 2 :: 2] = 200
    _, picture = read(compressed(image(pixels, layout), 95))
    blue, green, red = picture[16:48, 16:48].reshape(-1, 3).mean(axis=0)
    assert red > 150
    assert max(blue, green) < 60


def test_deep_samples_lose_their_lower_bits() -> None:
    pixels = np.full((54, 72), 2048, np.uint16)
    _, picture = read(compressed(image(pixels, bit_depth=12), 90))
    assert picture.dtype == np.uint8
    assert abs(float(picture.mean()) - 128) <= 1


def test_colour_keeps_its_order() -> None:
    red = np.zeros((64, 64, 3), np.uint8)
    red[..., 0] = 200
    _, picture = read(compressed(image(red, "RGB"), 95))
    assert picture[32, 32, 2] > 150 > picture[32, 32, 0]


@pytest.mark.parametrize("cut", [0, 3, 4, 12, 40, 90, 3000])
def test_what_is_cut_off_is_refused(cut: int) -> None:
    with pytest.raises(UnreadableError):
        compressed(image(np.zeros((54, 72), np.uint8))[:cut], 90)


def test_only_so_many_are_compressed() -> None:
    sent, complaints, came = [], [], threading.Event()

    def publish(cdr: bytes) -> None:
        sent.append(cdr)
        came.set()

    thread = JpegThread(Compression(0.1, 80), publish, lambda: 1, complaints.append)
    for _ in range(10):
        thread.offer(image(np.zeros((54, 72), np.uint8)))
    assert came.wait(20.0)
    thread.offer(b"no image, and too early")
    thread.close()
    assert len(sent) == 1
    assert complaints == []


def test_nobody_hears_nothing_is_made() -> None:
    thread = JpegThread(Compression(100.0, 80), pytest.fail, lambda: 0, pytest.fail)
    thread.offer(b"an image")
    thread.close()
