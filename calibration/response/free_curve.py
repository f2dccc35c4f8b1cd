"""A response curve of free shape (Debevec & Malik 1997): least squares, smooth, monotone by construction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.response.curves import InverseCurve, Misfit, octaves, residuals
from calibration.response.tones import Curve, Tones

SMOOTHNESS = (1e4, 1e3, 1e2, 10.0, 1.0, 0.1)
"""Weights tried for the squared second derivative against squared errors of medians, the smoothest first.

Where exposures are evenly spaced, ripples of the same spacing in the curve explain a sweep as well as no ripples. So
the smoothest curve that explains it as well as the roughest is taken.
"""

SHOULDER_GREY = 4.0
"""Just below saturation curves may bend within this many grey levels, as those with a shoulder do."""
LEAST_STEP_STOPS = 1e-6
"""Least rise of the curve from one node to the next."""
_ROUNDS = 4
"""Weights follow from the slope of the curve, the curve from the weights; it settles within a few rounds."""
_SQUARE_UP_TO = 3.0
"""Standard deviations beyond which a residual counts by its size, no longer by its square."""


@dataclass(frozen=True, slots=True, eq=False)
class FreeFit:
    """The free curve that explains a sweep."""

    # curve, misfit: the smoothest curve that is as good as any, and how well it fits
    curve: InverseCurve
    misfit: Misfit
    errors_stops: Curve  # standard errors at its nodes, relative to the anchor
    smoothed_stops: Curve  # what the curve would change by if it were one degree rougher: about what smoothness hides


def fit_free(tones: Tones, within: NDArray[np.bool_], prior: InverseCurve, anchor: int) -> FreeFit:
    """The curve of free shape, by the medians of `within` (see `usable`), with errors relative to the node `anchor`.

    `prior` is what the curve is where the sweep says nothing: differences from it are kept smooth.
    """
    between = _Between.of(octaves(tones.greys, prior.black), prior.octaves)
    roughness = _roughness(_stretched(prior.greys, prior.black))
    fits = [_fit(tones, within, prior, between, smoothness * roughness) for smoothness in SMOOTHNESS]
    misfits = [Misfit.of(fit.curve, tones, within) for fit in fits]
    best = min(misfits, key=lambda misfit: misfit.size)
    place = next(i for i, misfit in enumerate(misfits) if misfit.as_good_as(best))
    chosen, rougher = fits[place], fits[min(place + 1, len(fits) - 1)]
    errors = chosen.scale * np.sqrt(np.maximum(_variances(chosen.normal, anchor), 0.0))
    smoothed = rougher.curve.stops - chosen.curve.stops
    return FreeFit(chosen.curve, misfits[place], errors, smoothed - smoothed[anchor])


def fit_as_smooth(tones: Tones, within: NDArray[np.bool_], prior: InverseCurve) -> InverseCurve:
    """The curve with the second strongest smoothing: fast, and good enough to compare sweeps by."""
    between = _Between.of(octaves(tones.greys, prior.black), prior.octaves)
    rough = SMOOTHNESS[1] * _roughness(_stretched(prior.greys, prior.black))
    return _fit(tones, within, prior, between, rough).curve


class _Fit(NamedTuple):
    """A curve, the matrix of its normal equations, and the size of the residuals in standard errors."""

    curve: InverseCurve
    normal: Curve
    scale: float


def _fit(tones: Tones, within: NDArray[np.bool_], prior: InverseCurve, between: _Between, rough: Curve) -> _Fit:
    curve = prior
    for _ in range(_ROUNDS):
        size = np.abs(residuals(curve, tones, within)) / tones.errors
        scale = max(1.48 * float(np.median(size[within])), 0.3)
        trust = 1.0 / np.maximum(size / (scale * _SQUARE_UP_TO), 1.0)
        weights = np.where(within, trust / (tones.errors * curve.slope(tones.greys)) ** 2, 0.0)
        normal, right = _without_radiances(between, weights, tones.levels)
        steps = _increasing(normal + rough, right + rough @ prior.stops)
        stops = np.concatenate([[0.0], np.cumsum(steps)])
        curve = InverseCurve(prior.greys, stops - stops[-1], prior.black)
    return _Fit(curve, normal + rough, scale)


@dataclass(frozen=True, slots=True, eq=False)
class _Between:
    """Where values lie between the nodes of a grid: after which node, and how far towards the next one."""

    node: NDArray[np.intp]
    share: Curve
    nodes: int

    @classmethod
    def of(cls, at: Curve, grid: Curve) -> _Between:
        node = np.clip(np.searchsorted(grid, at) - 1, 0, len(grid) - 2)
        return cls(node, np.clip((at - grid[node]) / (grid[node + 1] - grid[node]), 0.0, 1.0), len(grid))

    def to_nodes(self, values: Curve) -> Curve:
        """The sum of values, each shared out to the two nodes beside it, shape (nodes,)."""
        return self._summed(self.node, values, self.nodes)

    def to_nodes_by_group(self, values: Curve) -> Curve:
        """The same for each column, shape (columns, nodes)."""
        columns = self.node.shape[1]
        cells = self.node + self.nodes * np.arange(columns)
        return self._summed(cells, values, columns * self.nodes).reshape(columns, self.nodes)

    def squared(self, values: Curve) -> Curve:
        """The sum of values times the products of their shares in two nodes, shape (nodes, nodes)."""
        both = np.bincount(self.node.ravel(), (values * self.share * (1.0 - self.share)).ravel(), self.nodes)[:-1]
        return (
            np.diag(self.to_nodes(values) - np.append(both, 0.0) - np.append(0.0, both))
            + np.diag(both, 1)
            + np.diag(both, -1)
        )

    def _summed(self, cells: NDArray[np.intp], values: Curve, count: int) -> Curve:
        above = values * self.share
        summed = np.bincount(cells.ravel(), (values - above).ravel(), count)
        return np.asarray(summed + np.bincount(cells.ravel() + 1, above.ravel(), count))


def _stretched(greys: Curve, black: float) -> Curve:
    """The scale on which curves bend evenly: octaves of grey above black, less those of what saturation is above it."""
    return np.asarray(octaves(greys, black) - np.log2(greys[-1] + SHOULDER_GREY - greys))


def _roughness(grid: Curve) -> Curve:
    """The matrix of the integral of the squared second derivative over a scale."""
    left, right = np.diff(grid)[:-1], np.diff(grid)[1:]
    length = (left + right) / 2
    second = np.zeros((len(left), len(grid)))
    index = np.arange(len(left))
    second[index, index] = 1.0 / (left * length)
    second[index, index + 1] = -1.0 / (left * length) - 1.0 / (right * length)
    second[index, index + 2] = 1.0 / (right * length)
    return np.asarray(second.T @ (second * length[:, None]))


def _without_radiances(between: _Between, weights: Curve, levels: Curve) -> tuple[Curve, Curve]:
    """Normal equations of the nodes, with the radiance of each group eliminated: curve - radiance = level."""
    by_group = between.to_nodes_by_group(weights)
    total = np.maximum(weights.sum(axis=0), 1e-12)
    level_of_group = (weights * levels[:, None]).sum(axis=0)
    normal = between.squared(weights) - by_group.T @ (by_group / total[:, None])
    right = between.to_nodes(weights * levels[:, None]) - by_group.T @ (level_of_group / total)
    return normal, right


def _increasing(normal: Curve, right: Curve) -> Curve:
    """The steps between nodes, none below the least one.

    Steps that would be smaller are set to the least one and the others solved again, until all are large enough.
    """
    count = len(right)
    sums = np.tri(count, count - 1, -1)
    quadratic, linear = sums.T @ normal @ sums, sums.T @ right
    free = np.ones(count - 1, bool)
    steps = np.full(count - 1, LEAST_STEP_STOPS)
    while free.any():
        known = linear[free] - quadratic[np.ix_(free, ~free)] @ steps[~free]
        steps[free] = np.linalg.lstsq(quadratic[np.ix_(free, free)], known, rcond=None)[0]
        low = free & (steps < LEAST_STEP_STOPS)
        if not low.any():
            break
        steps[low] = LEAST_STEP_STOPS
        free &= ~low
    return steps


def _variances(normal: Curve, anchor: int) -> Curve:
    """The variances of the nodes relative to one of them."""
    count = len(normal)
    sums = np.tri(count, count - 1, -1)
    relative = sums - sums[anchor]
    return np.asarray(
        np.einsum("ij,ij->i", relative @ np.linalg.pinv(sums.T @ normal @ sums, hermitian=True), relative)
    )
