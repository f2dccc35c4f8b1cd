"""Frames shrunk for control: the preparation of Begin & Hunter 2022, algorithm 1, lines 38 and 39."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError

CONTROL_SIZE = (360, 270)
"""Width and height at which the paper measures its metric."""

FLOW_SIZE = (90, 68)
"""Width and height at which the paper estimates motion; no frame may be smaller."""


def fit(shape: tuple[int, ...], size: tuple[int, int]) -> tuple[int, int]:
    """(width, height) of an image of `shape` (height, width) shrunk to fit into `size`, never enlarged.

    The aspect ratio is kept; 4:3 gives the paper's 360x270 and 90x68 (67.5, rounded).
    """
    height, width = shape
    scale = min(1.0, size[0] / width, size[1] / height)
    return round(width * scale), round(height * scale)


class ImagePreparation:
    """Shrinks the whole scene to about 360x270 and takes a 3x3 median; reuses its buffers.

    Attributes
    ----------
    unfiltered
        The latest image before the median, valid until the next one.
    """

    def __init__(self) -> None:
        self.unfiltered = np.empty((0, 0), np.uint8)
        self._small = np.empty((0, 0), np.uint8)
        self._image = np.empty((0, 0), np.uint8)

    def prepare(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image that control works on, uint8, valid until the next call.

        Area averaging uses every pixel, so that thin structures do not flicker; at exactly one half, the usual case of
        720x540, it is also the cheapest.

        Parameters
        ----------
        grey
            8-bit grey levels, shape (height, width), at least 68 by 90.

        Raises
        ------
        ConfigurationError
            When the frame is too small.
        """
        height, width = grey.shape
        if width < FLOW_SIZE[0] or height < FLOW_SIZE[1]:
            raise ConfigurationError(
                f"frames of {width}x{height} pixels are too small: set at least 90x68 (a colour mosaic, seen at half "
                "its size: 180x136)"
            )
        small_width, small_height = fit(grey.shape, CONTROL_SIZE)
        if self._image.shape != (small_height, small_width):
            self._small = np.empty((small_height, small_width), np.uint8)
            self._image = np.empty((small_height, small_width), np.uint8)
        if self._image.shape == grey.shape:
            self.unfiltered = grey
        else:
            cv2.resize(grey, (small_width, small_height), dst=self._small, interpolation=cv2.INTER_AREA)
            self.unfiltered = self._small
        cv2.medianBlur(self.unfiltered, 3, dst=self._image)
        return self._image
