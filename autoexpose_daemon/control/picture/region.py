"""The part of a camera's picture that counts: rectangles and a mask, as weights of the prepared image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.picture.image import CONTROL_SIZE, Shrinking, fit
from imaging.errors import ConfigurationError

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
