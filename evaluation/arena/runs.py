"""The runs of the arena: which courses a time budget allows, each run spread over processes, and all in one table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

import numpy as np

from evaluation.arena.race import CourseScore, Series, run_course
from evaluation.arrays import Floats32
from evaluation.committed import HELD_OUT_SEED
from evaluation.jobs.job import Job, Plain
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.camera import Entrant
from imaging.python310 import Self

Split = Literal["tune", "heldout"]
QUICK_SEED = 2000  # Of quick arenas, which anyone may look at. Seeds 0 to 99 are for tuning; reports had 2000 to 2013.
MAIN_DELAY = 2  # The delay (frames) that results are for
OTHER_DELAYS = (1, 3)
PICTURE = ".hdr"  # Ends the name of a scene that is a file
TUNE_SCENES = ("room", "leaves", "street")
# The scenes that judge, with the number of their seeds, from `HELD_OUT_SEED`; `shelves` and `hall` with other seeds are
# in `worth-tuning`.
HELD_OUT_SEEDS = {"room": 14, "shelves": 8, "hall": 8}
TUNE_SEEDS = 3
SEEDS_OF_OTHER_DELAYS = 3  # Seeds per scene in the full arena: about 40 minutes on two cores for 14 policies


@dataclass(frozen=True, slots=True)
class Task:
    """One course, which all policies run side by side with each of the delays."""

    scenario: str
    scene: str
    seed: int
    delays: tuple[int, ...]
    split: Split
    keep_traces: bool = False

    @property
    def frames(self) -> int:
        """Frames of the course."""
        return SCENARIOS[self.scenario].frames


def full_plan(scenarios: Sequence[str], pictures: Sequence[str] = ()) -> list[Task]:
    """Every scenario in many scenes; `pictures` are .hdr files added to the held-out scenes, with one seed each."""
    tasks = []
    for scenario in scenarios:
        for scene, seeds in HELD_OUT_SEEDS.items():
            for index in range(seeds):
                delays = (MAIN_DELAY, *OTHER_DELAYS) if index < SEEDS_OF_OTHER_DELAYS else (MAIN_DELAY,)
                trace = scene == "room" and index == 0
                tasks.append(Task(scenario, scene, HELD_OUT_SEED + index, delays, "heldout", trace))
        tasks += [Task(scenario, picture, HELD_OUT_SEED, (MAIN_DELAY,), "heldout") for picture in pictures]
        tasks += [
            Task(scenario, scene, seed, (MAIN_DELAY,), "tune") for scene in TUNE_SCENES for seed in range(TUNE_SEEDS)
        ]
    return sorted(tasks, key=lambda task: -task.frames * len(task.delays))


def quick_plan(scenarios: Sequence[str], pictures: Sequence[str] = ()) -> list[Task]:
    """Every scenario once, cycling through the held-out scenes."""
    scenes = (*HELD_OUT_SEEDS, *pictures)
    tasks = [
        Task(scenario, scenes[index % len(scenes)], QUICK_SEED, (MAIN_DELAY,), "heldout", keep_traces=True)
        for index, scenario in enumerate(scenarios)
    ]
    return sorted(tasks, key=lambda task: -task.frames)


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What a plot of one run shows for each frame: exposure level (stops), the oracle's, and share of its metric."""

    levels: Floats32
    oracle_levels: Floats32
    ratios: Floats32
    first_scored: int

    @classmethod
    def of(cls, levels: list[float], oracle_levels: list[float], ratios: list[float], first_scored: int) -> Self:
        """From plain lists."""
        ours, best, shares = (np.array(each, np.float32) for each in (levels, oracle_levels, ratios))
        return cls(ours, best, shares, first_scored)

    def plain(self) -> dict[str, Plain]:
        """As plain lists."""
        arrays = {"levels": self.levels, "oracle_levels": self.oracle_levels, "ratios": self.ratios}
        return {**{name: values.tolist() for name, values in arrays.items()}, "first_scored": self.first_scored}


@dataclass(frozen=True, slots=True)
class ArenaRun:
    """One policy in one course with one delay."""

    policy: str
    scenario: str
    scene: str
    seed: int
    delay_frames: int
    split: Split
    score: CourseScore
    trace: Trace | None = None


FRAME_S = 0.005  # of one core per frame and policy, measured on full arenas of 14 policies


def jobs_of(task: Task, policies: Sequence[str]) -> list[Job]:
    """The runs of a course, a job for each policy: they go side by side where several are missing."""
    arguments: dict[str, Plain] = {
        "scenario": task.scenario, "scene": task.scene, "seed": task.seed, "delays": list(task.delays),
        "keep_traces": task.keep_traces,
    }  # fmt: skip
    files = ("scene",) if task.scene.endswith(PICTURE) else ()
    cost_s = task.frames * len(task.delays) * FRAME_S
    return [Job(measure_course, arguments, cost_s, (policy,), side_by_side=True, files=files) for policy in policies]


def measure_course(
    scenario: str, scene: str, seed: int, delays: Sequence[int], policies: Sequence[str], *, keep_traces: bool
) -> list[Plain]:
    """For each policy what became of it with each of the delays."""
    entrants = [Entrant.of(policy, delay) for policy in policies for delay in delays]
    found = [_plain(series, keep_traces) for series in run_course(scenario, scene, seed, entrants)]
    return [found[first : first + len(delays)] for first in range(0, len(found), len(delays))]


def _plain(series: Series, keep_trace: bool) -> Plain:
    levels, best, ratios = (each.astype(np.float32) for each in (series.levels, series.oracle_levels, series.ratios))
    trace = Trace(levels, best, ratios, series.first_scored) if keep_trace else None
    return {
        "delay_frames": series.entrant.delay_frames,
        "score": asdict(series.score()),
        "trace": None if trace is None else trace.plain(),
    }


def runs_of(task: Task, policy: str, results: Any) -> list[ArenaRun]:
    """The runs of a policy from the result of its job."""
    return [
        ArenaRun(
            policy, task.scenario, task.scene, task.seed, each["delay_frames"], task.split,
            CourseScore(**each["score"]), None if each["trace"] is None else Trace.of(**each["trace"]),
        )
        for each in results
    ]  # fmt: skip


MEANS = tuple(each.name for each in fields(CourseScore) if each.name != "settle_frames")


_OF_RUN = ("policy", "scenario", "scene", "seed", "delay_frames", "split")


def document(runs: Sequence[ArenaRun], default_policy: str) -> dict[str, Any]:
    """The JSON document: every run, and the results of the held-out runs with a delay of two frames."""
    ordered = sorted(runs, key=lambda run: (run.policy, run.scenario, run.scene, run.seed, run.delay_frames))
    return {
        "default_policy": default_policy,
        "runs": [{name: getattr(run, name) for name in _OF_RUN} | asdict(run.score) for run in ordered],
        "results": results([run for run in ordered if run.split == "heldout" and run.delay_frames == MAIN_DELAY]),
    }


def results(runs: Sequence[ArenaRun]) -> list[dict[str, Any]]:
    """One row per policy and scenario: the median of the frames to settle, the share of stuck runs, and means. In the
    median, a stuck run counts as settling later than all others. The median is None when it is itself stuck."""
    rows = []
    for policy, scenario in sorted({(run.policy, run.scenario) for run in runs}):
        group = [run for run in runs if (run.policy, run.scenario) == (policy, scenario)]
        settle = [math.inf if run.score.settle_frames is None else run.score.settle_frames for run in group]
        median = float(np.median(settle))
        rows.append(
            {
                "policy": policy,
                "scenario": scenario,
                "delay_frames": group[0].delay_frames,
                "split": group[0].split,
                "settle_frames": None if math.isinf(median) else median,
                **{name: float(np.mean([getattr(run.score, name) for run in group])) for name in MEANS},
                "stuck_share": sum(math.isinf(frames) for frames in settle) / len(settle),
            }
        )
    return rows
