"""Which exposure level to take: the best of the map, or one that would show more."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.extension import extension as _native
from autoexpose_daemon.control.picture.steering import STEERING_SHARE
from calibration.response import ResponseFunction

PLATEAU = 0.01
"""Anything within 1 % of the maximum is as good: its centre is farthest from both edges."""

DARK_SIGNAL = 1 / 16
"""A frame whose 99th percentile lies below this is dark: more than 3 stops up, prediction turns noise into gradient."""

EDGE = 0.1
"""`STEERING_SHARE` sets in over this share of the best worth, so noise does not push the target to and fro."""

LONGEST_JUMP = 7.0
"""Longest jump up out of the dark, stops."""

LEAST_CAMERA = 0.1
"""A camera that sees less than this share of the other's metric does not get a full vote."""

NOTHING = 1e-9
"""A metric this small counts as zero."""

LONGEST_PROBE = 6.5
"""A probe goes so many stops beyond the exposures seen when all is clipped."""

PROBE_WORTH_MOVING = 1.0
"""A still camera pays for a probe once and may look farther; a moving one would probe for ever: see `Probes`."""


@dataclass(frozen=True, slots=True)
class Probes:
    """How far to look for what is clipped, and what it may be worth, which depends on the objective.

    Attributes
    ----------
    shortest_stops
        How far beyond the exposures seen a probe goes when little is clipped; when all is, `LONGEST_PROBE`.
    power
        Of the clipped share, by which the length rises between the two.
    worth
        Of a clipped pixel to a still camera, as a multiple of a well exposed one; to a moving one `PROBE_WORTH_MOVING`.
    least_at_rest
        Saturated share from which a camera that has come to rest looks below once, whatever is promised there.
    """

    shortest_stops: float
    power: float
    worth: float
    least_at_rest: float = math.inf

    def length_stops(self, clipped_share: float) -> float:
        """How far a probe goes beyond the exposures seen."""
        return self.shortest_stops + (LONGEST_PROBE - self.shortest_stops) * float(clipped_share**self.power)

    def bonus(
        self, stops: NDArray[np.float64], clipped_share: float, density: float, moving: bool
    ) -> NDArray[np.float64]:
        """What the clipped part of a picture may be worth so many stops below it, if saturated, or above it, if black.

        In the metric's unit. With s the clipped share, x the distance in units of ``shortest + (longest - shortest)
        s^power`` stops and a the worth, it is ``a s density min(x, 2 - x)^p`` between x = 0 and 2; p is 1 in motion,
        else a half. `density` is the metric that a pixel of good exposure carries in this scene.
        """
        if clipped_share == 0.0:
            return np.zeros(stops.shape)
        worth, power = (PROBE_WORTH_MOVING, 1.0) if moving else (self.worth, 0.5)
        distance = stops / self.length_stops(clipped_share)
        shape = np.minimum(np.maximum(np.minimum(distance, 2.0 - distance), 0.0), 1.0) ** power
        return np.asarray(worth * clipped_share * density * shape)


def plateau_centre(levels: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Centre (stops) of the stretch around the maximum in which values stay within `PLATEAU` of it."""
    best = int(values.argmax())
    enough = (values >= values[best] * (1.0 - PLATEAU)).tolist()
    low = high = best
    while low > 0 and enough[low - 1]:
        low -= 1
    while high < len(levels) - 1 and enough[high + 1]:
        high += 1
    return float((levels[low] + levels[high]) / 2.0)


def within_reason(worth: NDArray[np.float64], steered: NDArray[np.float64]) -> NDArray[np.float64]:
    """What levels are worth to consumers, or nothing where the whole picture would lose too much."""
    kept = worth / max(float(worth.max()), 1e-9) - (1.0 - STEERING_SHARE)
    return np.asarray(steered * np.clip(kept / EDGE, 0.0, 1.0))


def worth_of_levels(
    levels: NDArray[np.float64],
    metrics: NDArray[np.float64],
    views: NDArray[np.float64],
    moving: bool,
    probes: Probes,
    *,
    frontier: float,
    known_again: float,
    highest: float,
) -> NDArray[np.float64]:
    """What each level promises, as a mean over cameras of shares of their best: float64, shape (n,).

    Parameters
    ----------
    levels
        Stops, shape (n,).
    metrics
        What each camera's metric is there, shape (cameras, n).
    views
        Saturated share, black share and density (see `Probes.bonus`) of each camera, shape (3, cameras).
    moving
        Whether the cameras move.
    probes
        What those shares may hide.
    frontier, known_again, highest
        Levels: the lowest that is known before the unknown, where knowledge begins again below it, and the highest.
    """
    if _native is not None:
        worth = np.empty(levels.size)
        _native.worth_of_levels(
            levels, metrics, views, moving, probes.shortest_stops, probes.power, probes.worth, frontier, known_again,
            highest, worth,
        )  # fmt: skip
        return worth
    unknown = levels > known_again
    # What a camera may yet see is part of its best, until a frame that covers it has shown whether it exists.
    hidden = np.maximum(views[0], views[1]) * views[2]
    best = np.maximum(metrics.max(axis=1), hidden)
    best = np.maximum(best, max(LEAST_CAMERA * float(best.max()), NOTHING))
    worth = np.zeros(levels.size)
    for metric, norm, (white, dark, density) in zip(metrics, best, views.T.tolist(), strict=True):
        below = unknown * probes.bonus(frontier - levels, white, density, moving)
        above = probes.bonus(levels - highest, dark, density, moving)
        worth += (metric + below + above) / norm
    return np.asarray(worth / len(metrics))


def value_at(level: float, levels: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """`np.interp` at one level, in less time than that takes to look at its arguments."""
    after = int(levels.searchsorted(level, "right"))
    if after in {0, levels.size}:
        return float(values[min(after, levels.size - 1)])
    low, high, first, second = (each.item(at) for each in (levels, values) for at in (after - 1, after))
    return (second - first) / (high - low) * (level - low) + first


def dark_jump(signal: float, response: ResponseFunction) -> float:
    """Stops that bring a 99th percentile of `signal` to full scale, at most 7; 0 for a frame that is not dark.

    What is best lies there or above: from a stop below, one more look would be needed.
    """
    if signal >= DARK_SIGNAL:
        return 0.0
    grey = round(signal * (response.saturation - response.black_level)) + response.black_level
    now, wanted = response.inverse(np.array([grey, response.saturation]))
    return float(min(wanted - now, LONGEST_JUMP))
