"""Rooms and headings of the drives, and intervals over them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evaluation.committed import FURNISHED_ROOMS
from evaluation.experiments.experiment import Claim, Verdict
from evaluation.experiments.statistics import FEWEST, Interval, mean_interval

ROOMS = FURNISHED_ROOMS
"""Rooms of full runs, each driven through once: its number is also the seed of its heading, so that no two courses
share anything."""

FEWEST_ROOMS = FEWEST
"""With fewer, draws say too little about the spread between rooms."""

ALIKE_MM = 0.1
"""Errors that differ by less are alike: so much do two runs of one policy differ that differ in noise alone."""


def over_rooms(values: NDArray[np.float64]) -> Interval:
    """Mean of one value for each room with its 95 % interval, which is unbounded for too few rooms."""
    if len(values) < FEWEST_ROOMS:
        return Interval(float(values.mean()), -math.inf, math.inf)
    return mean_interval(values)


def unless_few(claims: Sequence[Claim], rooms: int) -> list[Claim]:
    """The claims as judged; undecided where there were too few rooms."""
    if rooms >= FEWEST_ROOMS:
        return list(claims)
    return [replace(claim, verdict=Verdict.UNDECIDED, condition="too few rooms") for claim in claims]
