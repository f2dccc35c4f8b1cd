"""What the page shows of a frame: a picture with its extremes marked, its metric, and its prediction curve."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.image import ImagePreparation, fit
from autoexpose_daemon.control.metrics.gradient import ExtremeShares, GradientMetric, PackedTables
from calibration.response import ResponseFunction
from calibration.response.prediction import prediction_tables

DISPLAY_SIZE = (720, 720)
"""Largest width and height of a picture sent to a browser."""

DELTA_LEVELS = np.linspace(-2.0, 2.0, 17)
"""Changes of level (stops) at which the metric is predicted: the range of algorithm 1."""

_SATURATED_BGR, _BLACK_BGR = (45, 35, 240), (255, 110, 20)
_JPEG = (
    cv2.IMWRITE_JPEG_QUALITY, 80,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,  # else marks bleed into their neighbours
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Picture:
    """A frame for a browser, and what control would measure on the whole of it.

    Attributes
    ----------
    jpeg
        Saturated pixels are red, black ones blue: the pixels that the shares count, in the image that control uses.
    metric
        M_g, 0..1 per pixel (eq. 5).
    saturated_share, black_share
        Shares (0..1) of its pixels, as in a decision.
    """

    jpeg: bytes
    metric: float
    saturated_share: float
    black_share: float


class PictureMaker:
    """Measures whole frames of one camera with the paper's metric, by the camera's response."""

    def __init__(self, response: ResponseFunction) -> None:
        self.response = response
        self._preparation = ImagePreparation()
        self._metric = GradientMetric()
        self._shares = ExtremeShares(response)
        self._tables = PackedTables(prediction_tables(response, DELTA_LEVELS.tolist()))

    def picture(self, grey: NDArray[np.uint8]) -> Picture:
        """The picture of 8-bit grey levels, shape (height, width), at least 68 by 90; ConfigurationError below."""
        image = self._preparation.prepare(grey)
        saturated, black = self._shares.measure(image)
        return Picture(self._marked(grey, image), self._metric.measure(image), saturated, black)

    def curve(self, grey: NDArray[np.uint8]) -> list[float]:
        """M_g at each of `DELTA_LEVELS`, as the response predicts it (eq. 20); at 0 it is the frame's own."""
        return [float(m) for m in self._metric.measure_predictions(self._preparation.prepare(grey), self._tables)]

    def _marked(self, grey: NDArray[np.uint8], image: NDArray[np.uint8]) -> bytes:
        """`grey` as JPEG, marked where the shares count pixels of its prepared `image`."""
        size = fit(grey.shape, DISPLAY_SIZE)
        small = grey if size == grey.shape[::-1] else cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        colours = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
        large = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
        colours[large >= self._shares.saturated_from] = _SATURATED_BGR
        colours[large <= self._shares.black_to] = _BLACK_BGR
        _, jpeg = cv2.imencode(".jpg", colours, _JPEG)
        return jpeg.tobytes()
