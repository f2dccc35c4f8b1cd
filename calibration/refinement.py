"""Whether a response still holds, from the images of daily work: pairs of frames between which the exposure changed.

Between two frames in a row the scene is nearly the same, whatever moves in it: quantiles of the one are those of the
other under another exposure. Where the response is right, the log2 exposures of the two differ by the change of level.
What is left over tells how the curve must bend.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from calibration.agreement import CLIPPED_GREY, log2_exposure
from calibration.prediction import prediction_tables
from calibration.response import GREY_LEVELS, ResponseFunction

LEAST_CHANGE_STOPS = 0.25
"""Smaller changes of exposure tell little, and are those that follow a light that changes slowly."""
MOST_CHANGE_STOPS = 3.0
STEADY_CHANGE_STOPS = 0.1
STEADY_LIGHT_STOPS = 0.03
"""Only what follows two frames between which neither exposure nor light changed by more is used."""
LEAST_PAIRS = 30
"""Fewer do not average the motion of the scene out."""
QUANTILES = np.linspace(0.03, 0.97, 24)
KNOTS = np.linspace(0.0, 1.0, 9) ** 1.5 * (GREY_LEVELS - 1)
"""Grey levels at which the curve is bent; straight in between."""
MOST_PAIRS = 300
"""The latest count: a response that drifts is followed."""
MOST_LEFT_OVER = 1.5
"""Share of the change of level that a wrong curve can leave over; more is light that stepped in the same moment."""
QUANTILE_ERROR_STOPS = 0.15
"""What motion moves a quantile by, from one frame to the next."""
LEAST_SPREAD_STOPS = 0.02
ROUNDS = 6
BEND_STOPS = 0.5
"""By how much the curve may bend from one knot to the next before it takes many pairs to believe it."""
LEAST_STEP_STOPS = 1e-6

Values = NDArray[np.float64]


class ResponseWatch:
    """Compares what a response predicts with what the frames of one camera show, and finds a better one.

    Parameters
    ----------
    response
        The response that the camera is thought to have.
    """

    def __init__(self, response: ResponseFunction) -> None:
        self.pairs = 0
        self._response = response
        self._learned: deque[tuple[Values, Values]] = deque(maxlen=MOST_PAIRS)
        self._seen = np.zeros(GREY_LEVELS, bool)
        self._last: tuple[Values, float] | None = None
        self._steady = False

    def observe(self, grey8: NDArray[np.uint8], level: float) -> None:
        """Take the next frame: its grey levels, or every n-th of them, and the exposure level (stops) it really had."""
        quantiles = _quantiles(grey8)
        last, self._last = self._last, (quantiles, level)
        if last is None:
            return
        change = level - last[1]
        if LEAST_CHANGE_STOPS <= abs(change) <= MOST_CHANGE_STOPS:
            if self._steady:
                self._learn(last[0], quantiles, change)
            self._steady = False
        else:
            self._steady = abs(change) <= STEADY_CHANGE_STOPS and self._same_light(last[0], quantiles, change)

    def interrupt(self) -> None:
        """The next frame does not follow the last one: one between them was lost."""
        self._last, self._steady = None, False

    @property
    def refined(self) -> ResponseFunction | None:
        """The response bent to what was seen; None before enough was."""
        if self.pairs < LEAST_PAIRS:
            return None
        curve = self._response.log2_exposure + np.interp(np.arange(GREY_LEVELS), KNOTS, _bend(self._learned))
        steps = np.maximum(np.diff(curve), LEAST_STEP_STOPS)
        curve = np.concatenate([[0.0], np.cumsum(steps)])
        black, saturation = self._response.black_level, self._response.saturation
        return ResponseFunction(curve - curve[saturation], black, saturation)

    @property
    def drift_grey(self) -> float | None:
        """By how many grey levels (rms) predictions over one stop up and down are off, where images were seen."""
        refined = self.refined
        if refined is None:
            return None
        old, new = (prediction_tables(response, (-1.0, 1.0)).astype(float) for response in (self._response, refined))
        open_ends = self._seen & (old > self._response.black_level) & (old < self._response.saturation)
        return float(np.sqrt(np.mean((new - old)[open_ends] ** 2))) if open_ends.any() else None

    def _open(self, quantiles: Values) -> NDArray[np.bool_]:
        """Those that are neither black nor saturated."""
        low, high = self._response.black_level + CLIPPED_GREY, self._response.saturation - CLIPPED_GREY
        return (low < quantiles) & (quantiles < high)

    def _left_over(self, before: Values, after: Values, change: float) -> Values:
        """Stops between two images that the change of level does not explain."""
        return change - (log2_exposure(self._response, after) - log2_exposure(self._response, before))

    def _same_light(self, before: Values, after: Values, change: float) -> bool:
        both = self._open(before) & self._open(after)
        if not both.any():
            return False
        return float(abs(np.median(self._left_over(before, after, change)[both]))) <= STEADY_LIGHT_STOPS

    def _learn(self, before: Values, after: Values, change: float) -> None:
        both = self._open(before) & self._open(after)
        before, after = before[both], after[both]
        if not len(before):
            return
        left_over = self._left_over(before, after, change)
        if abs(np.median(left_over)) > MOST_LEFT_OVER * abs(change):
            return
        self._learned.append((_hats(after) - _hats(before), left_over))
        for quantiles in (before, after):
            self._seen[int(quantiles.min()) : int(quantiles.max()) + 1] = True
        self.pairs += 1


def _quantiles(grey8: NDArray[np.uint8]) -> Values:
    """Grey levels between whole ones at `QUANTILES`."""
    below = np.cumsum(np.bincount(grey8.ravel(), minlength=GREY_LEVELS)) / grey8.size
    return np.asarray(np.interp(QUANTILES, below, np.arange(GREY_LEVELS) + 0.5) - 0.5)


def _hats(greys: Values) -> Values:
    """The share of each knot in the bend at grey levels, shape (greys, knots)."""
    return np.stack([np.interp(greys, KNOTS, knot) for knot in np.eye(len(KNOTS))], axis=1)


def _bend(learned: Collection[tuple[Values, Values]]) -> Values:
    """Stops to add to the curve at the knots, by least squares in which a pair unlike the others hardly counts."""
    rows = np.concatenate([pair for pair, _ in learned])
    left_over = np.concatenate([stops for _, stops in learned])
    lengths = np.array([len(stops) for _, stops in learned])
    pair = np.repeat(np.arange(len(lengths)), lengths)
    # Quantiles of one image move together: three of them tell apart.
    weight = 3.0 / (len(QUANTILES) * QUANTILE_ERROR_STOPS**2)
    trust = np.ones(len(lengths))
    for _ in range(ROUNDS):
        weighted = rows * (weight * trust[pair])[:, None]
        bend = np.linalg.solve(_prior() + weighted.T @ rows, weighted.T @ left_over)
        off = np.bincount(pair, left_over - rows @ bend) / lengths
        spread = max(1.5 * float(np.median(np.abs(off))), LEAST_SPREAD_STOPS)
        trust = 1.0 / (1.0 + (off / (2.0 * spread)) ** 2) ** 2
    return np.asarray(bend)


def _prior() -> Values:
    """No bend, until images ask for one; the last knot stays where it is, since offsets mean nothing."""
    second = np.diff(np.eye(len(KNOTS)), n=2, axis=0)
    prior = second.T @ second / BEND_STOPS**2 + 1e-3 * np.eye(len(KNOTS))
    prior[-1, -1] += 1e6
    return np.asarray(prior)
