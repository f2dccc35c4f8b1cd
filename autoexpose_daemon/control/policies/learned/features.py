"""What the nets see of a frame: shares of its pixels by grey level, and figures of 4x4 regions."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import ExtremeShares, grey_counts, saturated_from
from autoexpose_daemon.control.policy import Look
from imaging.response import GREY_LEVELS, ResponseFunction

BINS = 32
"""Of a histogram. The last one is for saturated pixels alone; the others are evenly spaced over the root of what is
counted, so that dark frames, where a stop is a few grey levels, do not all fall into one bin."""

GRID = 4
"""Rows and columns of regions."""

REGION_FIGURES = 3 * GRID * GRID


def grey_histogram(look: Look) -> NDArray[np.float64]:
    """Shares of the pixels that count, by grey level, shape (BINS,), sum 1."""
    return _shares(look, by_light=False)


def light_histogram(look: Look) -> NDArray[np.float64]:
    """The same by the light behind grey levels, as the camera's response says."""
    return _shares(look, by_light=True)


def _shares(look: Look, *, by_light: bool) -> NDArray[np.float64]:
    counts = grey_counts(look.image, look.weights) @ _bins(look.response, by_light)
    return np.asarray(counts / float(counts.sum()))


def region_figures(look: Look) -> NDArray[np.float64]:
    """Mean signal (0 at the black level, 1 at saturation), saturated and black share of each region.

    Shape (REGION_FIGURES,): the means row by row, then the saturated, then the black shares. A region of which nothing
    counts has the figures of the whole picture.
    """
    ends = ExtremeShares(look.response)
    rows, columns = (np.linspace(0, size, GRID + 1).round().astype(int) for size in look.image.shape)
    saturated = cv2.threshold(look.image, ends.saturated_from - 1, 255, cv2.THRESH_BINARY)[1]
    black = cv2.threshold(look.image, ends.black_to, 255, cv2.THRESH_BINARY_INV)[1]
    if look.weights is None:
        greys: NDArray[Any] = look.image
        area = np.outer(np.diff(rows), np.diff(columns)).astype(np.float64)
        full = 255.0
    else:
        greys = np.asarray(cv2.multiply(look.image, look.weights, dtype=cv2.CV_32F), np.float32)
        saturated, black = cv2.bitwise_and(saturated, look.weights), cv2.bitwise_and(black, look.weights)
        area = _sums(look.weights, rows, columns)
        full = 1.0
    sums = np.stack([_sums(each, rows, columns) for each in (greys, saturated, black)])
    seen = area > 0
    shares = sums / np.where(seen, area, 1.0)
    whole = sums.sum(axis=(1, 2)) / area.sum()
    shares = np.where(seen, shares, whole[:, None, None])
    shares[0] = (shares[0] - look.response.black_level) / (look.response.saturation - look.response.black_level)
    shares[1:] /= full
    return np.asarray(shares.ravel())


def _sums(values: NDArray[Any], rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.float64]:
    """Sum of each region, exact, shape (GRID, GRID)."""
    corners = cv2.integral(values, sdepth=cv2.CV_64F)[np.ix_(rows, columns)]
    return np.diff(np.diff(corners, axis=0), axis=1)


@lru_cache(maxsize=16)
def _bins(response: ResponseFunction, by_light: bool) -> NDArray[np.float32]:
    """1 where a grey level belongs to a bin, shape (GREY_LEVELS, BINS)."""
    greys = np.arange(float(GREY_LEVELS))
    span = response.saturation - response.black_level
    signal = response.light(greys) if by_light else (greys - response.black_level) / span
    places = np.minimum((BINS - 1) * np.sqrt(np.clip(signal, 0.0, 1.0)), BINS - 2).astype(int)
    places[saturated_from(response) :] = BINS - 1
    table = np.zeros((GREY_LEVELS, BINS), np.float32)
    table[np.arange(GREY_LEVELS), places] = 1.0
    return table
