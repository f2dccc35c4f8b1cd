"""Intervals over courses: repeats of one course are not independent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.experiment import Claim, Verdict
from evaluation.experiments.statistics import Interval, mean_interval

ROOMS = (11, 12, 13)
"""Rooms of full runs; nothing was tuned on them."""

SEEDS = (0, 1, 2)
"""Headings in each room."""

FEWEST_COURSES = 3
"""With fewer, the spread between courses is unknown."""


def over_courses(values: NDArray[np.float64]) -> Interval:
    """Mean over courses with its 95 % interval, which is unbounded for fewer than three courses."""
    if len(values) < FEWEST_COURSES:
        return Interval(float(values.mean()), -math.inf, math.inf)
    return mean_interval(values)


def unless_few(claims: Sequence[Claim], courses: NDArray[np.int64]) -> list[Claim]:
    """The claims as judged; undecided where the runs went through fewer than three courses."""
    if len(np.unique(courses)) >= FEWEST_COURSES:
        return list(claims)
    return [replace(claim, verdict=Verdict.UNDECIDED, condition="too few courses") for claim in claims]


def by_course(courses: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (runs, ...) averaged over the repeats of each course, in the order of `courses`' first appearance."""
    order = list(dict.fromkeys(courses.tolist()))
    return np.array([values[courses == course].mean(axis=0) for course in order])
