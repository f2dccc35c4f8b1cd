"""How control sees one camera: prepared image, response function, weights of its region, and vignetting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import CELLS
from autoexpose_daemon.control.metrics.gradient import ExtremeShares
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.picture.region import Region
from autoexpose_daemon.control.policy import Look
from imaging.frames import Frame, Side
from imaging.pixels import MOSAIC_SHARE, is_mosaic
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting


class View:
    """Makes looks of one camera's frames; without a region everything counts, without vignetting as frames show it."""

    def __init__(
        self, response: ResponseFunction, region: Region | None = None, vignetting: Vignetting | None = None
    ) -> None:
        self.shares = ExtremeShares(response)
        self._response = response
        self._preparation = ImagePreparation()
        self._region, self._vignetting = region, vignetting
        self._relative_light = None if vignetting is None else _in_steps(vignetting.relative_light(CELLS, CELLS))
        self._weights: NDArray[np.uint8] | None = None
        self._shape: tuple[int, ...] = ()

    def look(self, side: Side, frame: Frame, *, filtered: bool = True) -> Look:
        """What a policy sees of a frame, valid until the next call; `filtered`: with the median."""
        grey = frame.grey8(self._response.saturation)
        image = self._preparation.prepare(grey, filtered=filtered)
        if frame.pixels.shape != self._shape:
            self._fit(side, frame.pixels.shape, grey.shape)
        scale = frame.pixels.shape[1] / image.shape[1]
        counted = MOSAIC_SHARE if is_mosaic(frame.layout) else 1.0
        averaged = counted * scale**2
        unfiltered, light = self._preparation.unfiltered, self._relative_light
        return Look(
            side, image, self._response, self._weights, unfiltered, scale, averaged, light, frame.setting,
            frame.device_time_ns,
        )  # fmt: skip

    def _fit(self, side: Side, shape: tuple[int, ...], seen: tuple[int, ...]) -> None:
        """Fit region and vignetting to frames of a shape; control sees a plane of them, of the shape `seen`."""
        if self._region is not None:
            self._weights = self._region.weights(shape, seen)
        if self._vignetting is not None:
            self._vignetting.check_size((shape[1], shape[0]), f"the {side} camera")
        self._shape = shape


def _in_steps(light: NDArray[np.float32]) -> NDArray[np.float64]:
    """The relative light of cells to a quarter of a stop, shape (cells,): few levels, and none of them costs much."""
    return np.exp2(np.round(4.0 * np.log2(light.astype(np.float64).ravel())) / 4.0)
