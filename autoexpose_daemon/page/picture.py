"""What the page shows of a frame: a picture with its extremes marked, its metric, and its prediction curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import ExtremeShares, GradientMetric, PackedTables
from autoexpose_daemon.control.picture.image import ImagePreparation, Shrinking, fit
from imaging.errors import ConfigurationError
from imaging.frames import Frame
from imaging.response import ResponseFunction, prediction_tables

DISPLAY_SIZE = (720, 720)
"""Largest width and height of a picture sent to a browser."""

DELTA_LEVELS = np.linspace(-2.0, 2.0, 17)
"""Changes of level (stops) at which the metric is predicted: the range of algorithm 1."""

_LONGEST_STRIP = 100
"""Length to width of a frame: nothing of the width of a much longer one is left at the size that control uses."""

_SATURATED_BGR, _BLACK_BGR = (45, 35, 240), (255, 110, 20)
_MOST_BALANCE = 4.0
_JPEG = (
    cv2.IMWRITE_JPEG_QUALITY, 80,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,  # else marks bleed into their neighbours
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FramePicture:
    """A frame for a browser, and what control would measure on the whole of it.

    Attributes
    ----------
    jpeg
        Saturated pixels are red, black ones blue: the pixels that the shares count, in the image that control uses.
    width
        Of what control and navigation see of the frame; they see a colour mosaic at half its size.
    metric
        M_g, 0..1 per pixel (eq. 5).
    saturated_share, black_share
        Shares (0..1) of its pixels, as in a decision.
    """

    jpeg: bytes
    width: int
    metric: float
    saturated_share: float
    black_share: float


class PictureMaker:
    """Measures whole frames of one camera with the paper's metric, using the camera's response."""

    def __init__(self, response: ResponseFunction) -> None:
        self.response = response
        self._preparation = ImagePreparation()
        self._metric = GradientMetric()
        self._shares = ExtremeShares(response)
        self._tables = PackedTables(prediction_tables(response, DELTA_LEVELS.tolist()))

    def picture(self, frame: Frame) -> FramePicture:
        """The picture of a frame, in its colours; ConfigurationError if it is too small for control, or too narrow."""
        grey = frame.grey8(self.response.saturation)
        image = self._prepared(grey)
        saturated, black = self._shares.measure(image)
        jpeg = self._marked(in_colours(frame), image)
        return FramePicture(jpeg, grey.shape[1], self._metric.measure(image), saturated, black)

    def curve(self, frame: Frame) -> list[float]:
        """M_g at each of `DELTA_LEVELS`, as the response predicts it (eq. 20); at 0 it is the frame's own."""
        image = self._prepared(frame.grey8(self.response.saturation))
        return [float(m) for m in self._metric.measure_predictions(image, self._tables)]

    def _prepared(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        height, width = grey.shape
        if max(height, width) > _LONGEST_STRIP * min(height, width):
            raise ConfigurationError(f"frames of {width}x{height} pixels are too narrow")
        return self._preparation.prepare(grey)

    def _marked(self, colours: NDArray[np.uint8], image: NDArray[np.uint8]) -> bytes:
        """`colours` (BGR) as JPEG, marked where the shares count pixels of its prepared `image`."""
        size = fit(colours.shape[:2], DISPLAY_SIZE)
        small = Shrinking(colours.shape, size).shrink(colours).copy()
        large = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
        small[large >= self._shares.saturated_from] = _SATURATED_BGR
        small[large <= self._shares.black_to] = _BLACK_BGR
        _, jpeg = cv2.imencode(".jpg", small, _JPEG)
        return jpeg.tobytes()


def in_colours(frame: Frame) -> NDArray[np.uint8]:
    """A frame's colours as its camera sent them: BGR, shape (height, width, 3), uint8.

    A mosaic, which sensors send without white balance, is balanced so that its mean is grey.
    """
    pixels: Any = frame.pixels if frame.bit_depth == 8 else (frame.pixels >> frame.bit_depth - 8).astype(np.uint8)
    match frame.layout:
        case "grey":
            colours = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
        case "RGB":
            colours = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
        case "BGR":
            colours = pixels
        case "YUYV":  # OpenCV's own YUYV is not full range
            u, v = (np.repeat(pixels[:, place::2, 1], 2, axis=1) for place in (0, 1))
            colours = cv2.cvtColor(np.dstack([pixels[..., 0], v, u]), cv2.COLOR_YCrCb2BGR)
        case mosaic:
            colours = _balanced(cv2.cvtColor(pixels, getattr(cv2, f"COLOR_Bayer{mosaic}2BGR")))
    return np.asarray(colours, np.uint8)


def _balanced(colours: Any) -> Any:
    blue, green, red, _ = cv2.mean(colours)
    gains = [min(green / max(mean, 1.0), _MOST_BALANCE) for mean in (blue, green, red)]
    tables = [np.clip(gain * np.arange(256), 0, 255).astype(np.uint8) for gain in gains]
    return cv2.LUT(colours, cv2.merge([table.reshape(256, 1) for table in tables]))
