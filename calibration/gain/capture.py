"""Which gains are looked at: more of them where the gain bends."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from calibration.gain.look import Look, look, look_near
from calibration.sources.sweep_plan import FIRST_TIME_US, StaticCamera

MOST_LOOKS = 33
FIRST_LOOKS = 9
"""Evenly spaced, whatever they show."""
BEND_DB = 0.1
"""If the middle of an interval lies farther than this from the line between its ends, its halves are looked at."""
FLOAT_STEPS = 1024
"""A gain without increments is looked at in steps of this part of its range."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class GainLooks:
    """Two passes over the same gains, each in rising order of the gain; the second was taken in reverse.

    Light that changes steadily cancels in the mean of the two. The camera takes multiples of `step`.
    """

    there: tuple[Look, ...]
    back: tuple[Look, ...]
    step: float


def capture_gain(camera: StaticCamera, progress: Progress = lambda done, total: None) -> GainLooks:
    """Look at a static scene in steady light at enough gains to know all of them.

    Parameters
    ----------
    camera
        Driven in the gain's own numbers: the bounds and increment of its gain are those of the node.
    progress
        Called with the looks taken, and about how many there will be.
    """
    limits = camera.limits
    low, high = limits.min_gain_db, limits.max_gain_db
    step = limits.gain_step_db or (high - low) / FLOAT_STEPS
    looks: dict[float, Look] = {}

    def see(number: float, time_us: float) -> None:
        looks[number] = look_near(camera, number, time_us)
        progress(len(looks), 2 * max(len(looks), FIRST_LOOKS))

    see(low, FIRST_TIME_US)
    see(high, looks[low].time_us)
    spans = deque([(low, high)])
    while spans and len(looks) < MOST_LOOKS:
        below, above = spans.popleft()
        middle = low + round(((below + above) / 2.0 - low) / step) * step
        if not below < middle < above:
            continue
        see(middle, looks[below].time_us)
        if len(looks) + len(spans) < FIRST_LOOKS or _bends(looks[low], looks[below], looks[middle], looks[above]):
            spans += [(below, middle), (middle, above)]
    order = list(looks)
    back: dict[float, Look] = {}
    for number in reversed(order):
        back[number] = look(camera, number, looks[number].time_us)
        progress(len(looks) + len(back), 2 * len(looks))
    there, again = (tuple(way[number] for number in sorted(way)) for way in (looks, back))
    return GainLooks(there, again, step)


def _bends(reference: Look, below: Look, middle: Look, above: Look) -> bool:
    low_db, here_db, high_db = (seen.gain_db(reference) for seen in (below, middle, above))
    part = (middle.number - below.number) / (above.number - below.number)
    return math.isfinite(here_db) and abs(here_db - low_db - part * (high_db - low_db)) > BEND_DB
