"""Finds a point of one image in another to a fraction of a pixel, by matching the patch around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HALF = 5
"""Half the size of patches, pixels."""

FAINT = 1.0
"""Standard deviation (grey levels) that a patch needs to be distinguishable from its surroundings."""


def place(
    source: NDArray[np.uint8],
    target: NDArray[np.uint8],
    points: NDArray[np.float64],
    guesses: NDArray[np.float64],
    reach: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Where points of `source` are in `target`, and for which of them the answer is reliable.

    Patches are compared at integer shifts by the sum of squared differences; parabolas through the smallest one and its
    neighbours give the fractions. Patches are normalised to the same mean and contrast, because exposure differs.

    Parameters
    ----------
    source, target
        uint8 images of the same shape.
    points, guesses
        x and y in pixels, (n, 2).
    reach
        How far from the guess to look in x and y, pixels; 0 for not at all.
    """
    height, width = source.shape
    at, near = np.rint(points).astype(np.intp), np.rint(guesses).astype(np.intp)
    limit = np.array([width, height])
    margin = HALF + np.array(reach)
    inside = ((at >= HALF) & (at < limit - HALF) & (near >= margin) & (near < limit - margin)).all(axis=1)
    at, near = np.where(inside[:, None], at, HALF), np.where(inside[:, None], near, margin)
    patch, contrast = _normalised(_cut(source, at, (HALF, HALF)))
    area = _cut(target, near, (HALF + reach[0], HALF + reach[1]))
    size = 2 * HALF + 1
    costs = np.empty((len(at), 2 * reach[1] + 1, 2 * reach[0] + 1), np.float32)
    for row, column in np.ndindex(costs.shape[1:]):
        window, _ = _normalised(area[:, row : row + size, column : column + size])
        difference = window - patch
        costs[:, row, column] = np.einsum("nij,nij->n", difference, difference)
    best = costs.reshape(len(at), costs.shape[1] * costs.shape[2]).argmin(axis=1)
    rows, columns = best // costs.shape[2], best % costs.shape[2]
    index = np.arange(len(at))
    x, x_good = _least(costs[index, rows], columns)
    y, y_good = _least(costs[index, :, columns], rows)
    found = near + np.column_stack([x - reach[0], y - reach[1]]) + (points - at)
    return found, inside & x_good & y_good & (contrast > FAINT)


def _cut(image: NDArray[np.uint8], at: NDArray[np.intp], half: tuple[int, int]) -> NDArray[np.float32]:
    """The surroundings of points (n, 2), shape (n, rows, columns)."""
    rows = at[:, 1, None] + np.arange(-half[1], half[1] + 1)
    columns = at[:, 0, None] + np.arange(-half[0], half[0] + 1)
    return np.asarray(image[rows[:, :, None], columns[:, None, :]], np.float32)


def _normalised(patches: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Patches of mean 0 and standard deviation 1, and the deviations they had."""
    centred = patches - patches.mean(axis=(1, 2), keepdims=True)
    deviation = np.sqrt(np.einsum("nij,nij->n", centred, centred) / (patches.shape[1] * patches.shape[2]))
    return centred / np.maximum(deviation, 1e-3)[:, None, None], deviation


def _least(costs: NDArray[np.float32], least: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The fractional position of the smallest cost in each row, and whether it is not at an end."""
    last = costs.shape[1] - 1
    if last == 0:
        return np.zeros(len(costs), np.float64), np.ones(len(costs), np.bool_)
    middle = np.clip(least, 1, last - 1)
    index = np.arange(len(costs))
    before, here, after = (costs[index, middle + step].astype(np.float64) for step in (-1, 0, 1))
    bend = before - 2 * here + after
    fraction = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.asarray(middle + fraction, np.float64), np.asarray((least > 0) & (least < last))
