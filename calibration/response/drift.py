"""Whether a response still holds, seen from the frames of a camera at work; and brought up to date from them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imaging.response import GREY_LEVELS, ResponseFunction

Greys = NDArray[np.float64]

SHARES = np.linspace(0.03, 0.97, 48)
"""Shares of pixels whose grey levels are followed: unlike single pixels they hardly change when the camera moves."""

LEAST_STOPS, MOST_STOPS = 0.2, 2.5
"""Smaller changes of exposure show little; after greater ones few pixels are clear of both ends in both frames."""

SAME_STOPS = 0.02
CALM_GREY = 1.0
"""By how much the followed grey levels may move (rms) between the two frames before a change, and after it."""
CLIPPED_GREY = 3.0
"""This close to black or saturation, noise is cut off on one side."""
LEAST_FOLLOWED = 8
REMEMBERED = 128
ENOUGH = 12
"""Changes needed for a verdict: single ones may be due to the light."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """A change of exposure and of nothing else: the same parts of the scene before and after it."""

    stops: float  # the change of exposure level
    # before, after: grey levels of equal shares of pixels, not rounded, float64, shape (n,), n up to ``len(SHARES)``
    before: Greys
    after: Greys


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A frame: its exposure level, and pixels from all over it."""

    level: float
    pixels: NDArray[np.uint8]


class ResponseWatch:
    """Compares what a response predicts for changes of exposure with what frames then show.

    Light that changes at the same time would look like a wrong response. So a change counts only when the two frames
    before it, taken with one exposure, look alike, and so do the two frames after it. Not thread-safe.
    """

    def __init__(self, response: ResponseFunction) -> None:
        self._response = response
        self._seen: deque[_Seen] = deque(maxlen=4)
        self.changes: deque[Change] = deque(maxlen=REMEMBERED)  # the latest of those that counted
        self._misses_grey: deque[float] = deque(maxlen=REMEMBERED)
        self.counted = 0  # how many changes have counted in all

    @property
    def residual_grey(self) -> float | None:
        """By how many grey levels (rms) the response misses a change of exposure, in the median; None: too few yet."""
        return float(np.median(self._misses_grey)) if len(self._misses_grey) >= ENOUGH else None

    def see(self, image: NDArray[np.uint8], level: float) -> None:
        """The next frame of the camera, and the exposure level it was taken with (stops).

        `image` are some thousand pixels from all over the frame, uint8; kept until four more have arrived.
        """
        self._seen.append(_Seen(level, image))
        if len(self._seen) < 4:
            return
        first, before, after, last = self._seen
        stops = after.level - before.level
        still = max(abs(before.level - first.level), abs(last.level - after.level)) <= SAME_STOPS
        if still and LEAST_STOPS <= abs(stops) <= MOST_STOPS:
            self._judge(stops, *(followed_greys(seen.pixels) for seen in self._seen))

    def interrupt(self) -> None:
        """Note that a frame is missing before the next one."""
        self._seen.clear()

    def _judge(self, stops: float, first: Greys, before: Greys, after: Greys, last: Greys) -> None:
        """Keep the change between the second and the third of four frames, if nothing but the exposure changed."""
        if max(_rms(first - before), _rms(after - last)) > CALM_GREY:
            return
        low, high = self._response.black_level + CLIPPED_GREY, self._response.saturation - CLIPPED_GREY
        open_ends = np.logical_and.reduce([(low <= greys) & (greys <= high) for greys in (before, after)])
        if open_ends.sum() >= LEAST_FOLLOWED:
            change = Change(stops, before[open_ends], after[open_ends])
            self.changes.append(change)
            self._misses_grey.append(miss_grey(self._response, change))
            self.counted += 1


def followed_greys(image: NDArray[np.uint8]) -> Greys:
    """The grey levels below which `SHARES` of the pixels lie, between whole levels too."""
    counts = np.bincount(image.ravel(), minlength=GREY_LEVELS)
    cumulated = np.concatenate(([0.0], np.cumsum(counts) / counts.sum()))
    return np.asarray(np.interp(SHARES, cumulated, np.arange(GREY_LEVELS + 1) - 0.5))


def misfit_grey(response: ResponseFunction, changes: list[Change]) -> float:
    """By how many grey levels (rms) a response misses changes of exposure, in the median over the changes."""
    return float(np.median([miss_grey(response, change) for change in changes]))


def miss_grey(response: ResponseFunction, change: Change) -> float:
    """By how many grey levels (rms) the response misses one change of exposure."""
    predicted = response.intensity(response.inverse_between(change.before) + change.stops)
    return _rms(predicted - change.after)


def _rms(values: Greys) -> float:
    return float(np.sqrt(np.mean(values**2)))


LEAST_CHANGES = 48
LEAST_GAIN = 0.3
"""Share of the misfit that must disappear, on changes that were not used for the fit."""
_KNOTS = 32
_STIFFNESS = 1.0  # stops of bend from knot to knot that cost as much as a typical misfit
_HUBER_STOPS = 0.1
_ROUNDS = 5


def refine(response: ResponseFunction, changes: list[Change]) -> ResponseFunction | None:
    """The response that explains the changes better; None if the present one holds, or for too few changes.

    The correction of f^-1 is a broken line over 32 steps of log grey, fitted by least squares to
    ``f^-1(after) - f^-1(before) = dE`` with Huber's weights and a penalty on bends. Every other change is kept for the
    test.
    """
    if len(changes) < LEAST_CHANGES:
        return None
    fitted, tried = changes[::2], changes[1::2]
    refined = _corrected(response, _fit(response, fitted))
    better = misfit_grey(refined, tried) <= (1.0 - LEAST_GAIN) * misfit_grey(response, tried)
    return refined if better else None


def _fit(response: ResponseFunction, changes: list[Change]) -> Greys:
    """Correction of f^-1 at the knots (stops); that at the last one, saturation, is 0 by convention."""
    before = np.concatenate([change.before for change in changes])
    after = np.concatenate([change.after for change in changes])
    stops = np.concatenate([np.full(len(change.before), change.stops) for change in changes])
    missing = stops - (response.inverse_between(after) - response.inverse_between(before))
    design = (_hats(response, after) - _hats(response, before))[:, :-1]
    # Dark grey levels are rounded coarsely: half a grey level, in stops, is the noise of an equation.
    noise = _half_grey_stops(response, before) + _half_grey_stops(response, after) + _HUBER_STOPS / 10.0
    bends = np.diff(np.eye(_KNOTS), 2, axis=0)[:, :-1] / _STIFFNESS * np.sqrt(len(missing)) / 10.0
    weights = 1.0 / noise
    knots = np.zeros(_KNOTS - 1)
    for _ in range(_ROUNDS):
        left = np.vstack((design * weights[:, None], bends))
        right = np.concatenate((missing * weights, np.zeros(len(bends))))
        knots = np.linalg.lstsq(left, right, rcond=None)[0]
        off = np.abs(missing - design @ knots)
        weights = np.sqrt(np.minimum(1.0, _HUBER_STOPS / np.maximum(off, 1e-9))) / noise
    return np.append(knots, 0.0)


def _corrected(response: ResponseFunction, knots: Greys) -> ResponseFunction:
    greys = np.arange(GREY_LEVELS, dtype=np.float64)
    curve = np.maximum.accumulate(response.inverse(np.arange(GREY_LEVELS)) + _hats(response, greys) @ knots)
    return ResponseFunction(curve, response.black_level, response.saturation)


def _hats(response: ResponseFunction, greys: Greys) -> Greys:
    """Weights of the knots at each grey level, shape (n, knots): linear between neighbours, summing to 1."""
    span = float(response.saturation - response.black_level)
    octave = np.log2(1.0 + np.clip(greys - response.black_level, 0.0, span)) / np.log2(1.0 + span)
    place = octave * (_KNOTS - 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(_KNOTS))))


def _half_grey_stops(response: ResponseFunction, greys: Greys) -> Greys:
    return response.inverse_between(greys + 0.5) - response.inverse_between(greys - 0.5)
