"""Runs of a plan, spread over processes."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from evaluation.arena.plan import Split, Task
from evaluation.arena.race import Series, run_course
from evaluation.arena.scores import Score
from evaluation.pool import over_processes
from evaluation.stage.delayed_loop import Entrant


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What a plot of one run shows for each frame: exposure level (stops), the oracle's, and share of its metric."""

    levels: NDArray[np.float32]
    oracle_levels: NDArray[np.float32]
    ratios: NDArray[np.float32]
    first_scored: int


@dataclass(frozen=True, slots=True)
class Run:
    """One policy in one course with one delay."""

    policy: str
    scenario: str
    scene: str
    seed: int
    delay_frames: int
    split: Split
    score: Score
    trace: Trace | None = None


def run_task(task: Task, policies: Sequence[str]) -> list[Run]:
    """Run all policies through one course, with each of its delays."""
    entrants = [Entrant.of(policy, delay) for delay in task.delays for policy in policies]
    return [_run_of(task, series) for series in run_course(task.scenario, task.scene, task.seed, entrants)]


def run_plan(tasks: Sequence[Task], policies: Sequence[str], jobs: int) -> Generator[tuple[Task, list[Run]]]:
    """Run all tasks in `jobs` processes; yields each when it is done."""
    return over_processes(partial(run_task, policies=policies), tasks, jobs)


def _run_of(task: Task, series: Series) -> Run:
    trace = None
    if task.keep_traces:
        levels, best, ratios = (
            array.astype(np.float32) for array in (series.levels, series.oracle_levels, series.ratios)
        )
        trace = Trace(levels, best, ratios, series.first_scored)
    entrant = series.entrant
    return Run(
        entrant.name, task.scenario, task.scene, task.seed, entrant.delay_frames, task.split, series.score(), trace
    )
