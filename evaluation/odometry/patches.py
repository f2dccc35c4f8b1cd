"""Finds a point of one image in another to a fraction of a pixel, by matching the patch around it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fake_camera.world.compiled import compiled

HALF = 5
"""Half the size of patches, pixels."""

FAINT = 1.0
"""Standard deviation (grey levels) that a patch needs to be distinguishable from its surroundings."""

FLAT = 1e-3
"""A smaller one is not divided by."""


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
    costs, contrast = _costs(source, target, at, near, reach)
    best = costs.reshape(len(at), costs.shape[1] * costs.shape[2]).argmin(axis=1)
    rows, columns = best // costs.shape[2], best % costs.shape[2]
    index = np.arange(len(at))
    x, x_good = _least(costs[index, rows], columns)
    y, y_good = _least(costs[index, :, columns], rows)
    found = near + np.column_stack([x - reach[0], y - reach[1]]) + (points - at)
    return found, inside & x_good & y_good & (contrast > FAINT)


@compiled()  # type: ignore[untyped-decorator]
def _costs(
    source: NDArray[np.uint8],
    target: NDArray[np.uint8],
    at: NDArray[np.intp],
    near: NDArray[np.intp],
    reach: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """How much normalised patches differ at each shift, (n, rows, columns), and the deviation of each patch, (n,)."""
    reach_x, reach_y = reach
    costs = np.empty((len(at), 2 * reach_y + 1, 2 * reach_x + 1), np.float32)
    contrast = np.empty(len(at), np.float32)
    pixels = (2 * HALF + 1) ** 2
    for point in range(len(at)):
        x, y = at[point]
        patch = source[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1]
        mean, deviation = _moments(patch)
        contrast[point] = deviation
        for row in range(2 * reach_y + 1):
            for column in range(2 * reach_x + 1):
                left, top = near[point, 0] - reach_x + column - HALF, near[point, 1] - reach_y + row - HALF
                window = target[top : top + 2 * HALF + 1, left : left + 2 * HALF + 1]
                mean_there, deviation_there = _moments(window)
                shared = 0
                for i in range(2 * HALF + 1):
                    for j in range(2 * HALF + 1):
                        shared += int(patch[i, j]) * int(window[i, j])
                covariance = shared / pixels - mean * mean_there
                here, there = max(deviation, FLAT), max(deviation_there, FLAT)
                costs[point, row, column] = pixels * (
                    (deviation / here) ** 2 + (deviation_there / there) ** 2 - 2.0 * covariance / (here * there)
                )
    return costs, contrast


@compiled()  # type: ignore[untyped-decorator]
def _moments(window: NDArray[np.uint8]) -> tuple[float, float]:
    """Mean and standard deviation."""
    total, squares = 0, 0
    for i in range(window.shape[0]):
        for j in range(window.shape[1]):
            value = int(window[i, j])
            total += value
            squares += value * value
    mean = total / window.size
    return mean, math.sqrt(max(squares / window.size - mean * mean, 0.0))


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
