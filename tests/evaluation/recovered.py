"""The default policy with a recovered response function against the true one, through the same course."""

from __future__ import annotations

from autoexpose_daemon.control.loop import ControlLoop
from evaluation.arena.race import course_of, race
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.camera import Entrant
from evaluation.stage.oracle import Oracle
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.sweeps import Bench, solve_response, true_response


def _entrant(name: str, response: ResponseFunction) -> Entrant:
    def make(_: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
        return ControlLoop("belief", response, limits, start)

    return Entrant(name, 2, make)


def metric_ratios(curve: str, scenario: str, scene: str, seed: int) -> dict[str, float]:
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
