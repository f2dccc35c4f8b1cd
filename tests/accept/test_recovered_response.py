"""The default policy with recovered response functions: less than 1 % of the arena's metric ratio is lost."""

from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.control.loop import ControlLoop
from evaluation.arena.race import course_of, race
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.camera import Entrant
from evaluation.stage.oracle import Oracle
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.sweeps import Bench, solve_response, true_response

COURSES = (
    ("step_up", "leaves", 2000),
    ("step_down", "shelves", 2001),
    ("tunnel", "hall", 2002),
    ("pan", "shelves", 2000),
)


def _entrant(name: str, response: ResponseFunction) -> Entrant:
    def make(_: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
        return ControlLoop("belief", response, limits, start)

    return Entrant(name, 2, make)


def _metric_ratios(curve: str, scenario: str, scene: str, seed: int) -> dict[str, float]:
    """The mean metric ratio with the true, the recovered and, for comparison, a linear response."""
    responses = {
        "true": true_response(curve),
        "recovered": solve_response(Bench(curve).sweep()).response,
        "linear": ResponseFunction.linear(),
    }
    entrants = [_entrant(name, response) for name, response in responses.items()]
    kind = SCENARIOS[scenario]
    stage, first_scored = course_of(scenario, scene, seed, curve)
    runs = race(stage, entrants, Oracle(stage), frames=kind.frames, first_scored=first_scored, every=kind.oracle_every)
    return {run.entrant.name: run.score().metric_ratio_mean for run in runs}


@pytest.mark.parametrize("curve", ["linear", "gamma", "s_shaped"])
def test_less_than_one_percent_is_lost(curve: str) -> None:
    runs = [_metric_ratios(curve, *course) for course in COURSES]
    mean = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
    print(curve, {name: round(ratio, 4) for name, ratio in mean.items()})

    assert mean["recovered"] > 0.99 * mean["true"]
    if curve == "gamma":
        assert mean["linear"] < 0.99 * mean["true"]  # so the response does matter here
