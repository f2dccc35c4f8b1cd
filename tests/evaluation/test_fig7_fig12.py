"""The quick runs of the experiments with odometry show the effects that do not depend on chance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from evaluation.experiments.cache import ResultCache
from evaluation.experiments.drives import fig7, fig12, fixed_drives
from evaluation.experiments.drives.courses import by_course, over_courses
from evaluation.experiments.experiment import Experiment, Figure, Results, Section, Verdict
from evaluation.experiments.jobs import run_jobs
from evaluation.experiments.statistics import Interval
from tests.evaluation.sections import check_no_prose


@contextmanager
def quick(experiment: Experiment, folder: Path) -> Iterator[tuple[Any, Section]]:
    """The section, and the results of the last quick job, which stand for those of all jobs; all figures are there."""
    jobs = experiment.jobs(True)
    (measured,) = run_jobs(jobs[-1:], ResultCache(folder / "jobs"), 1, lambda _job, _took_s: None)
    results = [(job.arguments, measured) for job in jobs]
    section = experiment.section(results, folder)
    check_no_prose(section)
    for part in section.parts:
        if isinstance(part, Figure):
            picture = cv2.imread(str(folder / part.file))
            assert picture is not None and picture.shape[1] == 900
            assert (folder / part.file).stat().st_size < 120_000
    yield results, section


@pytest.mark.timeout(300)
def test_longer_exposures_cost_odometry_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    extremes = fixed_drives.SETTINGS[:: len(fixed_drives.SETTINGS) - 1]
    for module in (fixed_drives, fig7):
        monkeypatch.setattr(module, "SETTINGS", extremes)
    with quick(fig7.EXPERIMENT, tmp_path) as (results, section):
        runs = results[0][1]
        short, long = runs[0], runs[-1]
        assert long["rpe_mm"] > 1.15 * short["rpe_mm"]
        assert not any(run["failed"] for run in runs)
        # Noise causes gradients everywhere, though weak ones.
        assert short["proxies"][1] > long["proxies"][1]
        assert len(section.claims) == 3
        # One course proves nothing, and the report says so.
        assert {claim.verdict for claim in section.claims} == {Verdict.UNDECIDED}
        assert "inf" in section.claims[0].ours


@pytest.mark.timeout(300)
def test_begin2022_sees_more_than_the_built_in_exposure_and_blurs_less(tmp_path: Path) -> None:
    with quick(fig12.EXPERIMENT, tmp_path) as (results, section):
        runs = fig12.PolicyRuns(results)
        (ours,), (begin,), (built_in,) = (runs.of("low", policy) for policy in runs.policies)
        assert begin["metric"] > built_in["metric"] + 0.02
        assert ours["metric"] > built_in["metric"] + 0.02
        assert min(begin["gains_db"][4:]) > max(built_in["gains_db"]) > 0
        assert min(begin["times_us"]) < 0.8 * min(built_in["times_us"])
        assert {run["name"] for run in results[0][1]} == set(runs.policies)
        assert sum(claim.source == "this project" for claim in section.claims) == 2
        assert {claim.verdict for claim in section.claims} == {Verdict.UNDECIDED}
        assert "further" not in section.setting  # only a full run drives through more rooms


def test_repeats_do_not_count_as_courses() -> None:
    courses = np.array([5, 5, 3, 3])
    assert by_course(courses, np.array([1.0, 3.0, 10.0, 12.0])).tolist() == [2.0, 11.0]
    assert over_courses(np.array([2.0, 11.0])) == Interval(6.5, -math.inf, math.inf)
    assert over_courses(np.array([1.0, 1.0, 1.0])) == Interval(1.0, 1.0, 1.0)


def test_claims_are_judged_by_their_rules() -> None:
    """Made-up runs: ours 0.2 mm better than begin2022, and never failed."""
    rng = np.random.default_rng(0)

    def run(policy: str, rpe_mm: float, metric: float, failed: bool) -> dict[str, Any]:
        return {
            "name": policy, "rpe_mm": rpe_mm, "metric": metric, "failed": failed, "lost_share": 0.0,
            "times_us": [1000.0] * 9, "gains_db": [0.0] * 9, "metrics": [metric] * 9,
        }  # fmt: skip

    policies = ["metric-map", "begin2022", "neves2009"]
    results: Results = [
        (
            {"light": light, "room": room, "seed": seed, "repeat": 0, "policies": policies, "frames": 18},
            [
                run("metric-map", (base := rng.uniform(1, 3)) - 0.2 + rng.normal(0, 0.05), 0.3, False),
                run("begin2022", base, 0.3, light == "uneven"),
                run("neves2009", base - 0.5, 0.2, False),
            ],
        )
        for light in fig12.LIGHTS
        for room in (1, 2, 3)
        for seed in (0, 1, 2)
    ]
    runs = fig12.PolicyRuns(results)
    assert fig12._ours(runs, "uneven").verdict is Verdict.REPRODUCED
    assert "failed 0 and 9 of 9 runs" in fig12._ours(runs, "uneven").ours
    assert fig12._metric_is_higher(runs).verdict is Verdict.REPRODUCED
    assert fig12._error_is_lower(runs, "low").verdict is Verdict.NOT_REPRODUCED
    for _, of_course in results:
        of_course[0]["failed"] = True
    assert fig12._ours(runs, "low").verdict is Verdict.NOT_REPRODUCED  # smaller error, but more failures
