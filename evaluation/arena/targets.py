"""What the default policy must reach in the arena."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.arena.runs import Run


@dataclass(frozen=True, slots=True)
class Target:
    """A figure of held-out runs of one scenario, the least it must reach (None: no bound), and the least it should."""

    scenario: str
    what: str
    figure: Callable[[Sequence[Run]], float]
    must: float | None
    stretch: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """A target, and what was reached."""

    target: Target
    reached: float


def settled_within(per_delay: int, more: int) -> Callable[[Sequence[Run]], float]:
    """Share of the runs that settle within `per_delay` D + `more` frames."""

    def figure(runs: Sequence[Run]) -> float:
        frames = [(run.score.settle_frames, per_delay * run.delay_frames + more) for run in runs]
        return float(np.mean([settle is not None and settle <= bound for settle, bound in frames]))

    return figure


def _ratio(runs: Sequence[Run]) -> float:
    return float(np.mean([run.score.objective_ratio_mean for run in runs]))


def _worst(runs: Sequence[Run]) -> float:
    return float(np.mean([run.score.objective_ratio_p05 for run in runs]))


def _calm(runs: Sequence[Run]) -> float:
    return float(np.mean([run.score.steady_std_stops <= 0.1 for run in runs]))


TARGETS = (
    Target("step_up", "settled within 3D+2 frames, share of runs", settled_within(3, 2), 0.85, 0.95),
    Target("step_up", "settled within 3D frames, share of runs", settled_within(3, 0), None, 0.95),
    Target("step_down", "settled within 3D frames, share of runs", settled_within(3, 0), 0.95, 0.95),
    Target("step_down", "settled within 2D frames, share of runs", settled_within(2, 0), None, 0.95),
    Target("tunnel", "objective ratio, mean", _ratio, 0.95, 0.985),
    Target("pan", "objective ratio, mean", _ratio, 0.93, 0.97),
    Target("lowlight_fast", "objective ratio, mean", _ratio, 0.93, 0.97),
    Target("tunnel", "objective ratio, worst 5 % of frames", _worst, 0.80, 0.92),
    Target("pan", "objective ratio, worst 5 % of frames", _worst, 0.50, 0.80),
    Target("step_up", "spread of E at most 0.1 stop at the end, share of runs", _calm, 0.90, 1.0),
    Target("step_down", "spread of E at most 0.1 stop at the end, share of runs", _calm, 0.90, 1.0),
    Target("flicker", "objective ratio, mean", _ratio, 0.88, 0.95),
)


def outcomes(runs: Sequence[Run]) -> list[Outcome]:
    """What `runs` reached of each target whose scenario was run; all are held out, of one policy and one delay."""
    grouped = [(target, [run for run in runs if run.scenario == target.scenario]) for target in TARGETS]
    return [Outcome(target, target.figure(group)) for target, group in grouped if group]
