"""Runs summarised in one table, and the JSON document of both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from evaluation.arena.plan import MAIN_DELAY
from evaluation.arena.runs import Run

MEANS = (
    "overshoot_stops",
    "steady_std_stops",
    "metric_ratio_mean",
    "metric_ratio_p05",
    "bad_frame_share",
    "gain_db_mean",
    "objective_ratio_mean",
    "objective_ratio_p05",
    "any_split_ratio_mean",
    "pair_ratio_mean",
    "lost_pair_share",
)


def document(runs: Sequence[Run], default_policy: str) -> dict[str, Any]:
    """The JSON document: every run, and the results of the held-out runs with a delay of two frames."""
    ordered = sorted(runs, key=lambda run: (run.policy, run.scenario, run.scene, run.seed, run.delay_frames))
    return {
        "default_policy": default_policy,
        "runs": [
            {
                "policy": run.policy,
                "scenario": run.scenario,
                "scene": run.scene,
                "seed": run.seed,
                "delay_frames": run.delay_frames,
                "split": run.split,
                **asdict(run.score),
            }
            for run in ordered
        ],
        "results": results([run for run in ordered if run.split == "heldout" and run.delay_frames == MAIN_DELAY]),
    }


def results(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row per policy and scenario: the median of the frames to settle, the share of stuck runs, and means.

    In the median, a stuck run counts as settling later than all others. The median is None when it is itself stuck.
    """
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
