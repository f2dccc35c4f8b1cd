"""Frames shrunk for control: the preparation of Begin & Hunter 2022, algorithm 1, lines 38 and 39."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError

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


def median(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The 3x3 median of an image."""
    return np.asarray(cv2.medianBlur(image, 3), np.uint8)


class Shrinking:
    """Shrinks images of one shape to a size, close to an area average at any ratio; reuses its buffers.

    OpenCV averages by area slowly unless the ratio is 2: 11 ms for 5 megapixels. So an image is halved until it is less
    than four times too large, interpolated to two or four times the size, whichever is nearer, and halved again. All
    but the first halving costs about the same for any sensor. At exactly one half or a quarter, as for 720x540 and
    1440x1080, nothing is interpolated.

    Parameters
    ----------
    shape
        Of the images: height, width and, with several samples per pixel, their number.
    size
        Width and height to shrink to, no larger than the images.
    """

    def __init__(self, shape: tuple[int, ...], size: tuple[int, int]) -> None:
        height, width, *samples = shape
        sizes: list[tuple[int, int]] = []
        while width >= 4 * size[0] and height >= 4 * size[1] and (width, height) != size:
            width, height = width // 2, height // 2
            sizes.append((width, height))
        if (width, height) != size:
            steps = [(times * size[0], times * size[1]) for times in (4, 2, 1)]
            steps = steps[width < math.sqrt(8) * size[0] :]
            sizes += steps[(width, height) == steps[0] :]
        self._images = [np.empty((height, width, *samples), np.uint8) for width, height in sizes]

    def shrink(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The small image, uint8, valid until the next call; the image itself if it has this size."""
        for smaller in self._images:
            height, width = smaller.shape[:2]
            halves = (image.shape[0] // 2, image.shape[1] // 2) == (height, width)
            whole = image[: 2 * height, : 2 * width] if halves else image  # without the last of an odd number
            way = cv2.INTER_AREA if halves else cv2.INTER_LINEAR
            cv2.resize(whole, (width, height), dst=smaller, interpolation=way)
            image = smaller
        return image


class ImagePreparation:
    """Shrinks the whole scene to about 360x270 and takes a 3x3 median; reuses its buffers.

    Attributes
    ----------
    unfiltered
        The latest image before the median, valid until the next one.
    """

    def __init__(self) -> None:
        self.unfiltered = np.empty((0, 0), np.uint8)
        self._shape: tuple[int, ...] = (0, 0)
        self._shrinking = Shrinking((0, 0), (0, 0))
        self._image = np.empty((0, 0), np.uint8)

    def prepare(self, grey: NDArray[np.uint8], *, filtered: bool = True) -> NDArray[np.uint8]:
        """The image that control works on, uint8, valid until the next call.

        Every pixel counts, so thin structures do not flicker. Raises ConfigurationError when the frame is too small.

        Parameters
        ----------
        grey
            8-bit grey levels, shape (height, width), at least 68 by 90.
        filtered
            Whether to take the median.
        """
        height, width = grey.shape
        if width < FLOW_SIZE[0] or height < FLOW_SIZE[1]:
            raise ConfigurationError(
                f"frames of {width}x{height} pixels are too small: set at least 90x68 (a colour mosaic, seen at half "
                "its size: 180x136)"
            )
        if grey.shape != self._shape:
            size = fit(grey.shape, CONTROL_SIZE)
            self._shape, self._image = grey.shape, np.empty(size[::-1], np.uint8)
            self._shrinking = Shrinking(grey.shape, size)
        self.unfiltered = self._shrinking.shrink(grey)
        if not filtered:
            return self.unfiltered
        cv2.medianBlur(self.unfiltered, 3, dst=self._image)
        return self._image
