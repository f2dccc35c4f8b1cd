"""From looks at a flat field to the simplest vignetting that explains looks it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from calibration.vignetting.field import Array
from imaging.vignetting import LEAST_LIGHT, Vignetting, hats, middles, radius_squared

Kind = Literal["polynomial", "polynomial about a fitted centre", "grid"]

DEGREE = 4
"""Coefficients of the polynomial: r^2 to r^8. With one less, cos^4 down to 0.3 is missed by 5 % in the corners."""
NODES = 12
"""Nodes of the grid along the longer side."""
BETTER = 0.9
"""A model with more numbers must predict the looks held out with an error this many times as large, or less."""
_ROUNDS = 12
_REACH = 0.5
"""How far a fitted centre may be from the middle, in half diagonals."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A vignetting, and how well it is known; errors are shares of the light.

    Attributes
    ----------
    vignetting, kind
        The model that was chosen.
    held_out
        How far each kind, fitted to half of the looks, is from the other half, root mean square.
    misfit
        How far it is from the mean of all looks, at the worst place.
    spread
        How far it may be off because looks differ, at the worst place: half the difference between the two halves.
    """

    vignetting: Vignetting
    kind: Kind
    held_out: dict[Kind, float]
    misfit: float
    spread: float


def solve(looks: list[Array], size: tuple[int, int]) -> Solution:
    """The vignetting of frames of a width and height, from at least two looks; ConfigurationError if no lens does that.

    `looks` are the light of cells, each relative to its mean.
    """
    mean = np.mean(looks, axis=0)
    halves = [np.mean(looks[start::2], axis=0) for start in (0, 1)]
    fitted = {kind: [fit(half, size) for half in halves] for kind, fit in _FITS.items()}
    held_out = {
        kind: float(np.mean([off(model, other) for model, other in zip(models, reversed(halves), strict=True)]))
        for kind, models in fitted.items()
    }
    chosen: Kind = "polynomial"
    for kind in _FITS:
        if held_out[kind] < BETTER * held_out[chosen]:
            chosen = kind
    one, other = (_scaled(model, mean.shape) for model in fitted[chosen])
    vignetting = _FITS[chosen](mean, size)
    spread = float(np.abs(one / other - 1.0).max()) / 2.0
    misfit = float(np.abs(residuals(vignetting, mean)).max())
    return Solution(vignetting, chosen, held_out, misfit, spread)


def off(vignetting: Vignetting, light: Array) -> float:
    """How far cells are from a vignetting, as a share of their light, root mean square."""
    return float(np.sqrt(np.mean(residuals(vignetting, light) ** 2)))


def residuals(vignetting: Vignetting, light: Array) -> Array:
    """By how much each cell is brighter than a vignetting says, as a share."""
    return np.asarray(light / light.mean() / _scaled(vignetting, light.shape) - 1.0)


def fit_grid(light: Array, size: tuple[int, int], nodes: int = NODES) -> Vignetting:
    """The grid by least squares, with so many nodes along the longer side."""
    width, height = size
    rows, columns = light.shape
    short = max(min(round(nodes * min(size) / max(size)), min(light.shape) // 2), 2)
    long = max(min(nodes, max(light.shape) // 2), short)
    across, down = (long, short) if width >= height else (short, long)
    of_rows = np.linalg.pinv(hats(middles(rows, height), height, down))
    of_columns = np.linalg.pinv(hats(middles(columns, width), width, across))
    fitted = of_rows @ light @ of_columns.T
    grid = tuple(tuple(round(float(node), 5) for node in row) for row in fitted / fitted.max())
    return Vignetting(width, height, _middle(size), (), grid)


def fit_polynomial(light: Array, size: tuple[int, int], *, about_middle: bool) -> Vignetting:
    """The polynomial by least squares, about the middle of the picture or about the centre that fits best."""
    width, height = size
    x, y = middles(light.shape[1], width), middles(light.shape[0], height)
    centre = np.array(_middle(size))
    weights = 1.0 / np.maximum(light.ravel(), LEAST_LIGHT)  # errors count as shares of the light
    reach_px = _REACH * np.hypot(width, height) / 2.0
    for _ in range(0 if about_middle else _ROUNDS):  # Gauss and Newton, by the slope of the polynomial at its radius
        radius2, powers = _powers(x, y, centre, size)
        fitted = _weighted(powers, light.ravel(), weights)
        slope = np.polynomial.polynomial.polyval(radius2, np.polynomial.polynomial.polyder(fitted))
        scale = -8.0 / (width**2 + height**2)
        shifts = [slope * scale * np.broadcast_to(at, light.shape) for at in (x - centre[0], y[:, None] - centre[1])]
        design = np.column_stack((powers, *(shift.ravel() for shift in shifts)))
        step = _weighted(design, light.ravel() - powers @ fitted, weights)[-2:]
        length_px = float(np.hypot(*step))
        centre += step * min(1.0, 0.1 * reach_px / max(length_px, 1e-9))
        centre = np.clip(centre, np.array(_middle(size)) - reach_px, np.array(_middle(size)) + reach_px)
    _, powers = _powers(x, y, centre, size)
    fitted = _weighted(powers, light.ravel(), weights)
    coefficients = tuple(round(float(value / fitted[0]), 6) for value in fitted[1:])
    return Vignetting(width, height, (round(float(centre[0]), 2), round(float(centre[1]), 2)), coefficients)


def _powers(x: Array, y: Array, centre: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    radius2 = radius_squared(x, y, (float(centre[0]), float(centre[1])), size)
    return radius2, np.vander(radius2.ravel(), DEGREE + 1, increasing=True)


def _weighted(design: Array, values: Array, weights: Array) -> Array:
    return np.asarray(np.linalg.lstsq(design * weights[:, None], values * weights, rcond=1e-9)[0])


def _middle(size: tuple[int, int]) -> tuple[float, float]:
    return (size[0] - 1) / 2.0, (size[1] - 1) / 2.0


def _scaled(vignetting: Vignetting, shape: tuple[int, ...]) -> Array:
    """A vignetting in cells, relative to their mean, as looks are."""
    light = vignetting.relative_light(shape[0], shape[1]).astype(np.float64)
    return np.asarray(light / light.mean())


_FITS: dict[Kind, Callable[[Array, tuple[int, int]], Vignetting]] = {
    "polynomial": partial(fit_polynomial, about_middle=True),
    "polynomial about a fitted centre": partial(fit_polynomial, about_middle=False),
    "grid": fit_grid,
}
"""The simplest first."""
