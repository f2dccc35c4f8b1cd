"""The gradients of an image by cell and grey level, from which follows what contrast other exposures show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.extension import extension as _native
from autoexpose_daemon.control.metrics.gradient import saturated_from
from imaging.response import GREY_LEVELS, ResponseFunction

CELLS = 8
"""Cells across, and down."""


@dataclass(frozen=True, slots=True, eq=False)
class Contrast:
    """The gradients of an image by cell and bin of grey levels: sums over pixels, float64, shape (64, bins).

    A pixel is listed under the brightest among itself and the four that its gradient is computed from: the one that
    saturates first.
    """

    energy: NDArray[np.float64]  # ``(I(x + 1) - I(x - 1))^2 + (I(y + 1) - I(y - 1))^2``, times the pixel's weight
    count: NDArray[np.float64]  # its weight


class GreyBins:
    """Bins of grey levels: black is one, and what counts as saturated another.

    Between them bins are 1 grey level wide, and from 16, 48 and 112 above black on 2, 4 and 8: a tenth of the signal or
    so. Compared with a bin for each grey level, information changes by less than 1 %, and costs a third.

    Parameters
    ----------
    response
        Response function of the camera.
    dark_dn
        So many grey levels above its black count as black, too.

    Attributes
    ----------
    black, saturated
        The greatest grey level that is black, and the least that is saturated.
    of
        Bin of each grey level, uint8, shape (256,).
    count
        How many bins there are.
    """

    def __init__(self, response: ResponseFunction, dark_dn: int = 0) -> None:
        self.black, self.saturated = response.black_level + dark_dn, saturated_from(response)
        signal = np.maximum(np.arange(GREY_LEVELS) - self.black, 0)
        bins = signal.clip(0, 16) + (signal.clip(16, 48) - 16) // 2 + (signal.clip(48, 112) - 48) // 4
        bins += (signal.clip(112) - 112) // 8
        bins[self.saturated :] = bins[self.saturated - 1] + 1
        self.of = bins.astype(np.uint8)
        self.count = int(bins[-1]) + 1


def contrast(image: NDArray[np.uint8], bins: GreyBins, weights: NDArray[np.uint8] | None = None) -> Contrast:
    """Collect the gradients of an image, uint8, (height, width), at least 3x3; pixels of the border are left out.

    Parameters
    ----------
    bins
        Bins to collect them by.
    weights
        How much each pixel counts, uint8 of the shape of the image; None: all alike.
    """
    found = Contrast(*np.empty((2, CELLS * CELLS, bins.count)))
    _native.contrast_sums(image, bins.black, bins.saturated, found.energy, found.count, weights)
    return found
