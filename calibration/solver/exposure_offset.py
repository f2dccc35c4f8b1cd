"""What it does to a response if all exposures are longer than stated by the same time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calibration.solver.free_curve import fit_as_smooth
from calibration.solver.inverse_curve import InverseCurve, Misfit
from calibration.solver.tones import Curve, Tones

UNIFORM_STOPS = 1.0
"""Parts of the scene that differ by less see the same light at no two exposures, and so do not link them."""

SHARES = (-0.8, -0.4, -0.2, 0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 6.0)
"""Offsets tried, as shares of the shortest exposure that shows anything; the best is then refined."""

REFINED = 8
"""Golden sections, each of which leaves 0.62 of the range."""

ALIKE = 1.25
"""Medians of one image err together, which makes errors so much larger."""

STEP = 0.1
MOST_ERROR = 0.25
"""Of the shortest exposure: the step at which an error is measured, and the largest that counts."""

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def is_uniform(tones: Tones, within: NDArray[np.bool_], curve: InverseCurve) -> bool:
    """Whether a scene has one brightness only: then grey levels cannot tell a curve from wrong exposure times."""
    spans = [
        np.ptp(np.percentile(curve.at(greys[seen]), [2, 98]))
        for greys, seen in zip(tones.greys, within, strict=True)
        if seen.mean() > 0.5
    ]
    return bool(spans) and float(np.median(spans)) < UNIFORM_STOPS


def offset_changes(tones: Tones, within: NDArray[np.bool_], prior: InverseCurve) -> tuple[Curve, Curve]:
    """How the curve changes (stops) with the offset that explains the medians best, and with a standard error of it.

    Light seen at several exposures contradicts wrong times, so it takes a scene of more than one brightness. Light
    that drifts may look like an offset, too.
    """
    shortest = float(np.exp2(tones.levels[within.any(axis=1)].min()))

    def curve_of(share: float) -> InverseCurve:
        return fit_as_smooth(tones.longer(share * shortest), within, prior)

    def squares(share: float) -> float:
        return Misfit.of(curve_of(share), tones.longer(share * shortest), within).size ** 2

    best = int(np.argmin([squares(share) for share in SHARES]))
    share = _least(squares, SHARES[max(best - 1, 0)], SHARES[min(best + 1, len(SHARES) - 1)])
    step, least = STEP * (1.0 + share), squares(share)
    rise = max((squares(share + step) + squares(share - step)) / 2.0 - least, 1e-6 * least, 1e-12)
    error = min(ALIKE * step * float(np.sqrt(least / rise / within.sum())), MOST_ERROR * (1.0 + share))
    found, other = curve_of(share).stops, curve_of(share + error).stops
    return np.asarray(found - curve_of(0.0).stops), np.asarray(other - found)


def _least(function: Callable[[float], float], low: float, high: float) -> float:
    """Where between two values a function is least, by golden sections."""
    inner = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
    values = [function(each) for each in inner]
    for _ in range(REFINED):
        if values[0] < values[1]:
            high, inner[1], values[1] = inner[1], inner[0], values[0]
            inner[0] = high - _GOLDEN * (high - low)
            values[0] = function(inner[0])
        else:
            low, inner[0], values[0] = inner[0], inner[1], values[1]
            inner[1] = low + _GOLDEN * (high - low)
            values[1] = function(inner[1])
    return float(inner[int(np.argmin(values))])
