"""Images as JPEG: from an Image in CDR to a CompressedImage in CDR, a few times a second, on a thread of its own."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

_LITTLE_ENDIAN = b"\0\1\0\0"
_TO_BGR = {"rggb": "BayerBG", "grbg": "BayerGB", "gbrg": "BayerGR", "bggr": "BayerRG"}
"""OpenCV names a mosaic after its second row and column."""


@dataclass(frozen=True)
class Compression:
    """How many images a second of each camera, and how well, 1 to 100."""

    rate_hz: float
    quality: int


class UnreadableError(ValueError):
    """Bytes that are no image that can be compressed."""


class _Reader:
    """Reads CDR, little-endian."""

    def __init__(self, cdr: bytes) -> None:
        if cdr[:4] != _LITTLE_ENDIAN:
            raise UnreadableError("an Image that is no plain CDR")
        self._cdr, self._at = memoryview(cdr)[4:], 0

    def number(self, form: str) -> int:
        size = struct.calcsize(form)
        self._at += -self._at % size
        (value,) = struct.unpack_from(f"<{form}", self._cdr, self._at)
        self._at += size
        return int(value)

    def bytes(self) -> memoryview:
        count = self.number("I")
        self._at += count
        if self._at > len(self._cdr):
            raise UnreadableError("an Image that is cut off")
        return self._cdr[self._at - count : self._at]


def _text(data: bytes) -> bytes:
    return struct.pack("<I", len(data) + 1) + data + b"\0"


def _aligned(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def compressed(image: bytes, quality: int) -> bytes:
    """A CompressedImage of an Image; both are CDR. Bayer mosaics become colour, deep samples 8 bits.

    Raises UnreadableError for an image of another kind, ImportError without OpenCV.
    """
    import cv2  # noqa: PLC0415  not needed for anything else

    try:
        read = _Reader(image)
        stamp = read.number("i"), read.number("I")
        frame_id = bytes(read.bytes())[:-1]
        height, width = read.number("I"), read.number("I")
        encoding = bytes(read.bytes())[:-1].decode()
        read.number("B")
        step, data = read.number("I"), read.bytes()
        pixels, kind = _picture(cv2, encoding, (height, width), step, data)
        done, jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    except (struct.error, ValueError, KeyError, cv2.error) as error:
        raise UnreadableError(f"an image cannot be compressed: {error}") from error
    if not done:
        raise UnreadableError("an image cannot be compressed")
    header = _aligned(struct.pack("<iI", *stamp) + _text(frame_id))
    form = _aligned(_text(f"{encoding}; jpeg compressed {kind}".encode()))
    return _LITTLE_ENDIAN + header + form + struct.pack("<I", jpeg.size) + jpeg.tobytes()


def _picture(cv2: Any, encoding: str, shape: tuple[int, int], step: int, data: memoryview) -> tuple[Any, str]:
    """8-bit grey, or blue, green and red, and what image_transport calls that."""
    height, width = shape
    deep = encoding.endswith("16")
    samples = {"rgb8": 3, "bgr8": 3, "yuv422_yuy2": 2}.get(encoding, 1)
    if step * height != len(data) or step != width * samples * (2 if deep else 1):
        raise UnreadableError(f"{len(data)} bytes for {width}x{height}")
    pixels = np.frombuffer(data, np.uint16 if deep else np.uint8)
    if deep:
        pixels = (pixels >> 8).astype(np.uint8)
    pixels = pixels.reshape(height, width, samples) if samples > 1 else pixels.reshape(height, width)
    if encoding.startswith("mono"):
        return pixels, "mono8"
    if encoding.startswith("bayer_"):
        return cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{_TO_BGR[encoding[6:10]]}2BGR")), "bgr8"
    if encoding == "bgr8":
        return pixels, "bgr8"
    conversion = {"rgb8": cv2.COLOR_RGB2BGR, "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2}[encoding]
    return cv2.cvtColor(pixels, conversion), "bgr8"


class JpegThread:
    """Compresses the newest image offered, at most so many a second; frames never wait for it."""

    def __init__(
        self,
        compression: Compression,
        publish: Callable[[bytes], None],
        is_wanted: Callable[[], object],
        complain: Callable[[str], None],
    ) -> None:
        self._compression, self._publish, self._is_wanted, self._complain = compression, publish, is_wanted, complain
        self._newest: bytes | None = None
        self._due_s = 0.0
        self._news, self._closed = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name="jpeg", daemon=True)
        self._thread.start()

    def offer(self, image: bytes) -> None:
        """Take an image if it is time for one; on any thread."""
        now_s = time.monotonic()
        if now_s >= self._due_s and self._is_wanted():
            period_s = 1.0 / self._compression.rate_hz
            in_step_s = self._due_s + period_s
            self._due_s = in_step_s if in_step_s > now_s else now_s + period_s
            self._newest = image
            self._news.set()

    def close(self) -> None:
        """End it."""
        self._closed = True
        self._news.set()
        self._thread.join()

    def _run(self) -> None:
        while self._news.wait() and not self._closed:
            self._news.clear()
            image, self._newest = self._newest, None
            if image is not None:
                try:
                    self._publish(compressed(image, self._compression.quality))
                except (UnreadableError, ImportError) as error:
                    self._complain(str(error))
