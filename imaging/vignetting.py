"""The light that a lens lets through to each pixel, relative to the brightest part of the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError

Array = NDArray[np.float64]

LEAST_LIGHT = 0.02
"""Darker parts are outside of what a lens covers, and cannot be corrected."""
LARGEST_PIXELS = 65_536
MOST_NODES = 64
MOST_COEFFICIENTS = 8
LARGEST_NUMBER = 1000.0
_LOOK = (48, 64)


@dataclass(frozen=True, slots=True)
class Vignetting:
    """Relative light by an even polynomial of the radius, or by a grid of nodes with straight lines between them.

    Raises ConfigurationError for values that no lens has; the message begins with the key at fault.
    """

    # size of the frames it is for, in pixels
    width: int
    height: int
    centre_px: tuple[float, float]  # column and row around which light falls, for the polynomial
    # a2, a4, ... of ``1 + a2 r^2 + a4 r^4 + ...``; r is 1 at half the frame's diagonal from the centre
    coefficients: tuple[float, ...]
    # rows of nodes spread evenly from the first pixel to the last; empty: the polynomial holds
    grid: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        for key in ("width", "height"):
            if not 1 < getattr(self, key) <= LARGEST_PIXELS:
                raise ConfigurationError(f"{key} is {getattr(self, key)}: give the size of the frames in pixels")
        if self.grid:
            counts = {len(row) for row in self.grid} | {len(self.grid)}
            if len({len(row) for row in self.grid}) > 1 or min(counts) < 2 or max(counts) > MOST_NODES:
                raise ConfigurationError(f"grid must have 2 to {MOST_NODES} rows, all of 2 to {MOST_NODES} numbers")
        elif not 1 <= len(self.coefficients) <= MOST_COEFFICIENTS:
            raise ConfigurationError(f"coefficients must be 1 to {MOST_COEFFICIENTS} numbers: give a2, a4, ...")
        for at, pixels in zip(self.centre_px, (self.width, self.height), strict=True):
            if not -pixels <= at <= 2 * pixels:
                raise ConfigurationError(f"centre_px is {list(self.centre_px)}: give column and row near the picture")
        key, values = ("grid", sum(self.grid, ())) if self.grid else ("coefficients", self.coefficients)
        if not all(abs(value) <= LARGEST_NUMBER for value in values):
            raise ConfigurationError(f"{key} has numbers beyond {LARGEST_NUMBER:g}: give relative light")
        light = self._light(*_LOOK)
        if not light.min() > LEAST_LIGHT * light.max():
            raise ConfigurationError(
                f"{key} leave less than {LEAST_LIGHT:.0%} of the light in a part of the picture: measure again, and "
                "leave parts that the lens does not cover out of the camera's region"
            )

    def relative_light(self, rows: int, columns: int) -> NDArray[np.float32]:
        """The light at the middle of each of rows x columns parts of the frame, 1 at the brightest, float32."""
        light = self._light(rows, columns)
        return np.asarray(light / light.max(), np.float32)

    def as_plain(self) -> dict[str, Any]:
        """The keys of files and messages, with its values."""
        size: dict[str, Any] = {"width": self.width, "height": self.height}
        if self.grid:
            return {**size, "grid": [list(row) for row in self.grid]}
        return {**size, "centre_px": list(self.centre_px), "coefficients": list(self.coefficients)}

    def check_size(self, size: tuple[int, int], who: str) -> None:
        """Refuse frames of another size, sent by `who`; raises ConfigurationError."""
        if size != (self.width, self.height):
            raise ConfigurationError(
                f"the vignetting is for frames of {self.width}x{self.height} pixels, but {who} sends "
                f"{size[0]}x{size[1]}: measure it with this region, binning and decimation, or set those of the file"
            )

    def _light(self, rows: int, columns: int) -> Array:
        y, x = middles(rows, self.height), middles(columns, self.width)
        if self.grid:
            across, down = hats(x, self.width, len(self.grid[0])), hats(y, self.height, len(self.grid))
            return np.asarray(down @ np.array(self.grid) @ across.T)
        radius2 = radius_squared(x, y, self.centre_px, (self.width, self.height))
        return np.asarray(np.polynomial.polynomial.polyval(radius2, (1.0, *self.coefficients)))


def middles(parts: int, pixels: int) -> Array:
    """The middles of this many equal parts of a row or column, in pixels."""
    return (np.arange(parts) + 0.5) * pixels / parts - 0.5


def radius_squared(x: Array, y: Array, centre_px: tuple[float, float], size: tuple[int, int]) -> Array:
    """r^2 of `Vignetting` at columns `x` and rows `y`, shape (rows, columns)."""
    across, down = x - centre_px[0], y - centre_px[1]
    return np.asarray((across**2 + down[:, None] ** 2) * (4.0 / (size[0] ** 2 + size[1] ** 2)))


def hats(places: Array, pixels: int, nodes: int) -> Array:
    """Weights of evenly spread nodes at some places, shape (places, nodes): straight between neighbours."""
    at = np.clip(places / (pixels - 1), 0.0, 1.0) * (nodes - 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(nodes))))
