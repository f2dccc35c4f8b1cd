"""What the clipped parts of a picture may show at other exposures: what lies beyond is like what lies next to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEPTH_STEP = 0.25
DEPTHS: NDArray[np.float64] = np.arange(DEPTH_STEP / 2, 7.0, DEPTH_STEP)
"""How far above saturation (stops) saturated pixels may be, in steps that wide."""

NEXT_TO_WHITE = 0.5
"""Pixels that lie less than this (stops) below saturation tell what lies above it."""

BORROWED = 0.3
"""A cell counts as having so much more of the whole picture's saturated pixels, as a share of all its own pixels."""

FAR_RATE = 0.2
REACH = 2.0
"""Where few pixels lie next to white, as before a window, that holds for the next stops only: the rate at which
saturated pixels end, per stop, then rises towards `FAR_RATE`, by all but 1/e of the difference in `REACH` stops."""

SHADE = 2
"""Grey levels above black in which rounding hides contrast ..."""

LEAST_SHARE = 0.02
"""... which then is at least that of the brighter pixels, if there are so many."""


@dataclass(frozen=True, slots=True, eq=False)
class BinLevels:
    """Where the bins of `GreyBins` lie on the response function: float64, shape (bins,).

    Attributes
    ----------
    readable
        Share of its grey levels that are neither black nor saturated.
    slopes2
        Squared grey levels of contrast for a squared stop of it.
    stops
        Exposure level relative to saturation, at most 0.
    """

    readable: NDArray[np.float64]
    slopes2: NDArray[np.float64]
    stops: NDArray[np.float64]


def expected_unseen(signal: NDArray[np.float64], count: NDArray[np.float64], levels: BinLevels) -> NDArray[np.float64]:
    """Energy of gradients that a picture may yet show, by cell, squared stops, shape (64, `SHADE` + depths).

    First what the darkest grey levels may show besides what they do, then what saturated pixels may, by `DEPTHS`.

    Parameters
    ----------
    signal
        Energy of gradients without that of noise, by cell and bin, squared grey levels, shape (64, bins).
    count
        Pixels, by cell and bin.
    levels
        Of the bins.
    """
    return np.hstack([_expected_in_shade(signal, count, levels), _expected_above(signal, count, levels)])


def _expected_in_shade(
    signal: NDArray[np.float64], count: NDArray[np.float64], levels: BinLevels
) -> NDArray[np.float64]:
    """By cell and grey level: a cell is expected to have the contrast of the picture's brighter pixels at least."""
    dark, bright = slice(1, 1 + SHADE), levels.readable > 0
    bright[: 1 + SHADE] = False
    shown = signal[:, dark] / levels.slopes2[dark]
    if count[:, bright].sum() <= LEAST_SHARE * count.sum():
        return np.zeros(shown.shape)
    expected = count[:, dark] * _contrast(signal, count, levels, bright)
    lacking = (expected - shown) @ levels.slopes2[dark] > 0.0
    return np.where(lacking[:, None], expected - shown, 0.0)


def _expected_above(signal: NDArray[np.float64], count: NDArray[np.float64], levels: BinLevels) -> NDArray[np.float64]:
    """By cell and `DEPTHS`: the contrast of the pixels next to white.

    How many saturated pixels end within a stop is what lies within a stop below white, as a share of what is
    saturated: a bright wall goes on for a little, a window shows nothing for some stops.
    """
    next_to_white = (levels.readable > 0) & (levels.stops >= -NEXT_TO_WHITE)
    white, near = count[:, -1], count[:, next_to_white].sum(axis=1) / NEXT_TO_WHITE
    if not white.any():
        return np.zeros((len(count), DEPTHS.size))
    borrowed = BORROWED * count.sum() / len(count)
    rates = (near + borrowed * near.sum() / white.sum()) / (white + borrowed)
    left = np.exp(-_ended(rates[:, None], np.append(0.0, DEPTHS + DEPTH_STEP / 2)))
    ending = white[:, None] * (left[:, :-1] - left[:, 1:])
    return np.asarray(ending * _contrast(signal, count, levels, next_to_white))


def _ended(rates: NDArray[np.float64], stops: NDArray[np.float64]) -> NDArray[np.float64]:
    """The integral of the rate from white to so many stops above."""
    rising = FAR_RATE * stops + (rates - FAR_RATE) * REACH * (1.0 - np.exp(-stops / REACH))
    return np.asarray(np.where(rates < FAR_RATE, rising, rates * stops))


def _contrast(
    signal: NDArray[np.float64], count: NDArray[np.float64], levels: BinLevels, bins: NDArray[np.bool_]
) -> float:
    """Mean energy of gradients of the pixels in some bins, squared stops."""
    least = max(float(count[:, bins].sum(axis=0) @ levels.slopes2[bins]), 1e-9)
    return max(float(signal[:, bins].sum()), 0.0) / least
