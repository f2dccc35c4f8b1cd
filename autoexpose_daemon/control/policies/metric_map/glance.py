"""A frame in the few figures by which cameras are judged against each other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import grey_counts, saturated_from
from autoexpose_daemon.control.policy import Look
from calibration.response import ResponseFunction
from calibration.response.prediction import prediction_table

STRIDE = 8
"""Every eighth pixel across and down: some 1500 of 360x270, of which 15 are brighter than the 99th percentile."""

FAINT = 1 / 32
"""A 99th percentile below this, 8 grey levels, is nearly black. A capped lens stays below it in the noise of 30 dB."""

FAINTER = 4.0
"""A camera is black, not just dark, if half of another's pixels are this many times as bright as its brightest. As the
99th percentile lies some 2 stops above the median, the two cameras are then 4 stops apart or more: no exposure suits
both. Half of the pixels, because a lamp in one camera says nothing of what the other should see."""

WHITE_SHARE = 0.9
"""Saturated share above which a camera is white."""

TELLING_GREY = 4.0
"""Mean change in grey levels that a change of exposure must promise before its absence means anything."""

FROZEN_PART, RESPONSIVE_PART = 0.125, 0.5
"""Parts of the promised change: a frozen camera shows less, pixel by pixel, while another's mean shows more."""

THAWED_GREY = 1.0
"""Mean difference in grey levels from the image it was stuck at that shows a camera to be alive."""


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """A frame in a few figures; signals are 0 at the black level and 1 at saturation.

    Attributes
    ----------
    pixels
        Those that count, shrunk: uint8, one-dimensional.
    bright, median
        99th percentile and median of the signal.
    saturated_share
        0..1.
    promised, came
        Mean change of pixel values (grey levels, signed) from `before`, as its exposure promises and as it came; 0
        when the exposure is the same.
    before
        Pixels of an earlier frame; None when there is nothing to compare with.
    """

    pixels: NDArray[np.uint8]
    bright: float
    median: float
    saturated_share: float
    promised: float = 0.0
    came: float = 0.0
    before: NDArray[np.uint8] | None = None

    @property
    def difference(self) -> float:
        """Mean absolute change; infinite when there is nothing to compare with."""
        if self.before is None:
            return np.inf
        return float(np.abs(self.pixels - self.before.astype(np.int32)).sum()) / self.before.size

    @property
    def white(self) -> bool:
        """Whether nearly all is saturated."""
        return self.saturated_share > WHITE_SHARE

    @property
    def telling(self) -> bool:
        """Whether exposure promised a change that could not be overlooked."""
        return abs(self.promised) >= TELLING_GREY

    @property
    def stuck(self) -> bool:
        """Whether a change that exposure promised did not come, pixel by pixel."""
        return self.telling and self.difference < FROZEN_PART * abs(self.promised)

    @property
    def changed(self) -> bool:
        """Whether it is another picture than before."""
        return self.difference > THAWED_GREY

    @property
    def responsive(self) -> bool:
        """Whether the change came: an opposite change of light would have cancelled it."""
        return self.telling and self.came / self.promised > RESPONSIVE_PART

    def outshines(self, other: Glance) -> bool:
        """Whether this camera sees well while the other is black."""
        return other.bright < FAINT and self.median > FAINTER * other.bright and not self.white


def glance_at(look: Look, before: NDArray[np.uint8] | None, rise: float) -> Glance:
    """The figures of a frame, compared with pixels of one that was `rise` stops darker; None: with nothing."""
    pixels = look.image[::STRIDE, ::STRIDE]
    counted = pixels.flatten() if look.weights is None else pixels[look.weights[::STRIDE, ::STRIDE] > 0]
    if counted.size == 0:  # a region between the strides
        counted = pixels.flatten()
    black, saturation = look.response.black_level, look.response.saturation
    cumulative = grey_counts(counted[None]).cumsum()
    greys = cumulative.searchsorted(_ranks(counted.size)).tolist()
    median, bright = (max(grey - black, 0.5) / (saturation - black) for grey in greys)
    saturated = 1.0 - float(cumulative[saturated_from(look.response) - 1]) / counted.size
    if before is None or before.shape != counted.shape:
        return Glance(counted, bright, median, saturated)
    promised, came = _change(before, counted, look.response, rise) if rise != 0 else (0.0, 0.0)
    return Glance(counted, bright, median, saturated, promised, came, before)


@lru_cache(maxsize=2)
def _ranks(size: int) -> NDArray[np.float64]:
    """How many of so many pixels are half of them, and 99 %: the least number that makes this share."""
    shares = np.arange(size + 1) / size
    return shares.searchsorted((0.5, 0.99)).astype(np.float64)


def _change(
    before: NDArray[np.uint8], now: NDArray[np.uint8], response: ResponseFunction, rise: float
) -> tuple[float, float]:
    """(promised, came) of `Glance`; pixels clipped before promise nothing, and count as unchanged."""
    greys = np.arange(256, dtype=np.int32)
    unclipped = (greys > response.black_level) & (greys < response.saturation)
    promised = np.where(unclipped, prediction_table(response, rise) - greys, 0)[before].sum()
    came = (now - before.astype(np.int32)).sum(where=unclipped[before])
    return float(promised) / before.size, float(came) / before.size
