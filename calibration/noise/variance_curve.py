"""The photon transfer curve: how much grey levels vary from image to image, by how bright they are."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.sources.sweep import Shot

MOST_BINS = 1024
"""Bins of mean grey over the range of the format: one for each grey level of 8 bits, one for four of 12 bits."""
GROUPS = 512
"""Groups of pixels alike in brightness: finer than the bins, so that clipped pixels do not hide among others."""
MIN_DEGREES = 50
"""With fewer pixels, the variance of a bin is known to no better than 20 %."""

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class VarianceCurve:
    """Temporal variance over mean grey (DN), one entry for each bin of mean grey that holds enough pixels.

    Attributes
    ----------
    mean
        Mean grey of the bin's pixels, increasing.
    variance
        Variance of one grey level from image to image (DN squared), quantisation taken out.
    degrees
        Degrees of freedom of that variance: its relative standard error is sqrt(2 / degrees).
    bin_width
        Width of the bins (DN); the first begins at 0.
    step
        Difference between neighbouring grey levels: 16 if 12 bits are sent as 16.
    """

    mean: Array
    variance: Array
    degrees: Array
    bin_width: float
    step: int

    def variance_at(self, mean: Array) -> Array:
        """The variance at any grey level, between those of the bins."""
        return np.asarray(np.interp(mean, self.mean, self.variance))


def pairs_of(shots: Sequence[Shot]) -> list[tuple[int, int]]:
    """Indices of neighbouring shots of equal setting, each shot in one pair at most."""
    pairs: list[tuple[int, int]] = []
    for _, run in itertools.groupby(range(len(shots)), key=lambda index: shots[index].setting):
        alike = list(run)
        pairs += zip(alike[::2], alike[1::2], strict=False)
    return pairs


def grey_step(shots: Sequence[Shot]) -> int:
    """The greatest common divisor of all differences between grey levels."""
    seen = np.zeros(1 << 16, bool)
    for shot in shots:
        seen[shot.pixels] = True
    greys = np.flatnonzero(seen)
    return int(np.gcd.reduce(np.diff(greys))) if len(greys) > 1 else 1


def variance_curve(shots: Sequence[Shot], pairs: Sequence[tuple[int, int]]) -> VarianceCurve:
    """Half the variance of the difference of two images, by their mean: what stands still in the scene drops out.

    Pixels are grouped by how bright they are in the other pairs. Grouped by their own grey level, they would be
    sorted by their noise, too, and the darkest would be brighter pixels that their noise made dark. As variance is
    linear in the mean, it does not matter how alike the pixels of a group are. The mean difference is taken out group
    by group, and with it a change of the light between the two images.
    """
    means = [(shots[one].pixels.astype(np.float32) + shots[other].pixels).ravel() / 2.0 for one, other in pairs]
    total = np.sum(means, axis=0)
    count, mean, square = np.concatenate(
        [
            _groups(
                total - pair_mean, pair_mean, np.subtract(*(shots[index].pixels.astype(np.float32) for index in pair))
            )
            for pair, pair_mean in zip(pairs, means, strict=True)
        ],
        axis=1,
    )
    bins = min(2 ** shots[0].bit_depth, MOST_BINS)
    bin_width = 2 ** shots[0].bit_depth / bins
    index = (mean / bin_width).astype(np.intp)
    counts = np.bincount(index, count, bins)
    degrees = np.bincount(index, count - 1.0, bins)
    full = degrees >= MIN_DEGREES
    step = grey_step(shots)
    measured = np.bincount(index, square, bins)[full] / degrees[full] / 2.0
    variance = without_quantisation(measured / step**2) * step**2
    mean_grey = np.bincount(index, count * mean, bins)[full] / counts[full]
    return VarianceCurve(mean_grey, variance, np.asarray(degrees[full], np.float64), bin_width, step)


def _groups(brightness: Pixels, mean: Pixels, difference: Pixels) -> Array:
    """Pixel count, mean grey and sum of squares of the difference about its mean, by brightness; shape (3, groups)."""
    low, high = float(brightness.min()), float(brightness.max())
    index = ((brightness - low) * ((GROUPS - 1) / max(high - low, 1.0))).astype(np.intp)
    difference = difference.ravel()
    count, shift = np.bincount(index, minlength=GROUPS), np.bincount(index, difference, GROUPS)
    some = count > 1
    square = np.bincount(index, difference**2, GROUPS)[some] - shift[some] ** 2 / count[some]
    return np.stack([count[some], np.bincount(index, mean, GROUPS)[some] / count[some], square])


def quantised(variance: Array) -> Array:
    """The variance (steps squared) that differences of rounded values of that `variance` show, shape (n,).

    Large noise gains 1/12. Small noise gains less: none at all in the limit, where both images round alike. For values
    that lie anywhere between the steps, as those of a scene do, the gain is a Fourier series.
    """
    order = np.arange(1, 1000)[:, np.newaxis]
    damped = np.exp(-4.0 * np.pi**2 * order**2 * variance) / (2.0 * np.pi**2 * order**2)
    return np.asarray(variance + 1.0 / 12.0 - damped.sum(axis=0))


def without_quantisation(variance: Array) -> Array:
    """The inverse of `quantised`."""
    grid = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 400)])
    return np.where(variance > 1.0, variance - 1.0 / 12.0, np.interp(variance, quantised(grid), grid))
