"""Whether a response still holds, seen from the frames of a camera at work while its exposure changes anyway."""

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
    """A change of exposure and of nothing else: the same parts of the scene before and after it.

    Attributes
    ----------
    stops
        The change of exposure level.
    before, after
        Grey levels of equal shares of pixels, not rounded, float64, shape (n,), n up to ``len(SHARES)``.
    """

    stops: float
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

    Attributes
    ----------
    changes
        The latest of the changes that counted.
    counted
        How many have counted in all.
    """

    def __init__(self, response: ResponseFunction) -> None:
        self._response = response
        self._seen: deque[_Seen] = deque(maxlen=4)
        self.changes: deque[Change] = deque(maxlen=REMEMBERED)
        self._misses_grey: deque[float] = deque(maxlen=REMEMBERED)
        self.counted = 0

    @property
    def residual_grey(self) -> float | None:
        """By how many grey levels (rms) the response misses a change of exposure, in the median; None: too few yet."""
        return float(np.median(self._misses_grey)) if len(self._misses_grey) >= ENOUGH else None

    def see(self, image: NDArray[np.uint8], level: float) -> None:
        """The next frame of the camera, and the exposure level it was taken with (stops).

        Parameters
        ----------
        image
            Some thousand pixels from all over the frame, uint8; kept until four more have arrived.
        level
            In stops.
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
