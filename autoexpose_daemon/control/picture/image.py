"""Frames shrunk for control (Begin & Hunter 2022, algorithm 1, lines 38 and 39), and which part of them counts."""

from __future__ import annotations

import math
from dataclasses import dataclass

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

    `shape` is that of the images: height, width and, with several samples per pixel, their number; `size` is width and
    height to shrink to, no larger than the images.
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
    """Shrinks the whole scene to about 360x270 and takes a 3x3 median; reuses its buffers."""

    def __init__(self) -> None:
        self.unfiltered = np.empty((0, 0), np.uint8)  # the latest image before the median, valid until the next one
        self._shape: tuple[int, ...] = (0, 0)
        self._shrinking = Shrinking((0, 0), (0, 0))
        self._image = np.empty((0, 0), np.uint8)

    def prepare(self, grey: NDArray[np.uint8], *, filtered: bool = True) -> NDArray[np.uint8]:
        """The image that control works on, uint8, valid until the next call; `filtered`: with the median.

        `grey` has shape (height, width), at least 68 by 90. Every pixel counts, so thin structures do not flicker.
        Raises ConfigurationError when the frame is too small.
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


_REACH = np.ones((5, 5), np.uint8)
"""What a measure of one prepared pixel sees: the median filter one pixel around it, the gradient another one."""


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle in pixels of the camera's frames, and its weight, 0 to 1."""

    x: int
    y: int
    width: int
    height: int
    weight: float


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Which pixels of a camera count, and how much."""

    name: str  # what errors call this region: file and key of the configuration
    # painted in this order: where two overlap, the later one counts. Without any: the whole picture
    rectangles: tuple[Rectangle, ...] = ()
    background_weight: float = 0.0  # weight 0 to 1 of what no rectangle covers
    # grey 0 (does not count) to 255, uint8, of the size of the frames; multiplied with the rectangles
    mask: NDArray[np.uint8] | None = None

    @property
    def boxes(self) -> tuple[tuple[int, int, int, int], ...] | None:
        """x, y, width and height of the rectangles if these alone count, and equally; none: all of it does."""
        weighted = self.rectangles and (self.background_weight or any(one.weight != 1.0 for one in self.rectangles))
        if weighted or self.mask is not None:
            return None
        return tuple((one.x, one.y, one.width, one.height) for one in self.rectangles)

    def weights(self, shape: tuple[int, ...], seen: tuple[int, ...] | None = None) -> NDArray[np.uint8]:
        """Weights for the prepared image of frames of `shape` (height, width): uint8, of the prepared size.

        `seen` is the shape of what control sees of them (`Frame.grey8`), if it differs.

        A prepared pixel weighs as little as the least that it and its measures see, so not even the blurred edge of a
        masked part counts. Raises ConfigurationError when the region does not fit such frames, or leaves nothing that
        counts.
        """
        full = self._full_weights((shape[0], shape[1]))
        height, width = (seen or shape)[:2]
        size = fit((height, width), CONTROL_SIZE)
        small = cv2.resize(full, size, interpolation=cv2.INTER_AREA)
        ignored = cv2.resize(_white(full == 0), (width, height), interpolation=cv2.INTER_AREA)
        small[Shrinking((height, width), size).shrink(_white(ignored > 0)) > 0] = 0  # as the image is shrunk
        weights = np.asarray(cv2.erode(small, _REACH), np.uint8)
        if not weights.any():
            raise ConfigurationError(
                f"{self.name}: leaves no pixel of {shape[1]}x{shape[0]} frames that counts: enlarge the region"
            )
        return weights

    def check_something_counts(self) -> None:
        """Raise ConfigurationError if rectangles and background leave no pixel that counts, whatever the frame size."""
        if not self.rectangles or round(255 * self.background_weight):
            return
        # All pixels between two neighbouring edges are alike, so one of each is enough.
        columns = sorted({edge for one in self.rectangles for edge in (one.x, one.x + one.width)})
        rows = sorted({edge for one in self.rectangles for edge in (one.y, one.y + one.height)})
        weights = np.zeros((len(rows), len(columns)), np.float32)
        for one in self.rectangles:
            top, bottom = rows.index(one.y), rows.index(one.y + one.height)
            left, right = columns.index(one.x), columns.index(one.x + one.width)
            weights[top:bottom, left:right] = one.weight
        if not np.rint(255 * weights).any():
            raise ConfigurationError(f"{self.name}: no pixel counts: give a rectangle, or the background, more weight")

    def _full_weights(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        height, width = shape
        weights = np.full(shape, 1.0 if not self.rectangles else self.background_weight, np.float32)
        for index, rectangle in enumerate(self.rectangles):
            right, bottom = rectangle.x + rectangle.width, rectangle.y + rectangle.height
            if right > width or bottom > height:
                raise ConfigurationError(
                    f"{self.name}: rectangle {index} reaches to pixel ({right}, {bottom}), frames are {width}x{height}"
                )
            weights[rectangle.y : bottom, rectangle.x : right] = rectangle.weight
        if self.mask is not None:
            if self.mask.shape != shape:
                raise ConfigurationError(
                    f"{self.name}: the mask is {self.mask.shape[1]}x{self.mask.shape[0]} pixels, frames are "
                    f"{width}x{height}: draw it in the size of the frames"
                )
            weights *= self.mask.astype(np.float32) / 255
        return np.rint(255 * weights).astype(np.uint8)


def _white(where: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.where(where, np.uint8(255), np.uint8(0))
