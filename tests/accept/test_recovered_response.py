"""The default policy with recovered response functions: less than 1 % of the arena's metric ratio is lost."""

from __future__ import annotations

import numpy as np
import pytest

from tests.evaluation.recovered import metric_ratios

COURSES = (
    ("step_up", "leaves", 2000),
    ("step_down", "shelves", 2001),
    ("tunnel", "hall", 2002),
    ("pan", "shelves", 2000),
)


@pytest.mark.parametrize("curve", ["linear", "gamma", "s_shaped"])
def test_less_than_one_percent_is_lost(curve: str) -> None:
    runs = [metric_ratios(curve, *course) for course in COURSES]
    mean = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
    print(curve, {name: round(ratio, 4) for name, ratio in mean.items()})

    assert mean["recovered"] > 0.99 * mean["true"]
    if curve == "gamma":
        assert mean["linear"] < 0.99 * mean["true"]  # so the response does matter here
