"""Part of Fig. 13 with ORB-SLAM3, the paper's odometry, where it is installed."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np

from evaluation.experiments.drives.courses import ROOMS, over_courses
from evaluation.experiments.drives.fig12 import LIGHTS
from evaluation.experiments.drives.slam_drives import measure
from evaluation.experiments.experiment import Experiment, Job, Results, Section, Table
from evaluation.odometry.orb_slam3 import PACKAGE, installed
from evaluation.scenes.scenarios import RATE_HZ

POLICIES = ("metric-map", "begin2022")

_ABSENT = f"`{PACKAGE}` is not installed, so nothing was measured: see docs/odometry.md."

_SETTING = f"""\
The first heading of each room of fig12 with ORB-SLAM3 (`{PACKAGE}`) instead of our odometry. Its vocabulary of visual
words was made from our own frames of another room. Poses are those that it returns immediately, as a robot gets them.
It maps in its own threads, so these numbers differ from run to run. A few courses decide nothing: the numbers are for
comparison with those of our odometry."""


def jobs(quick: bool) -> list[Job]:
    """One for each light, room and policy; none if ORB-SLAM3 is not installed."""
    if not installed():
        return []
    rooms, seconds = ((1,), 1.7) if quick else (ROOMS, 8.0)
    return [
        Job(
            measure,
            {
                "light": light, "room": room, "seed": 0, "policy": policy, "frames": round(seconds * RATE_HZ),
                "version": version(PACKAGE),
            },
            cost_s=10.0 + 5.0 * seconds,
        )
        for light in LIGHTS
        for room in rooms
        for policy in POLICIES
    ]  # fmt: skip


def section(results: Results, _folder: Path) -> Section:
    """A table only: so few courses judge no claim."""
    if not results:
        return Section(_ABSENT, [], [])
    rows = []
    for light, title in LIGHTS.items():
        runs = {p: [one for case, one in results if case["light"] == light and case["policy"] == p] for p in POLICIES}
        ours, other = (np.array([run["rpe_mm"] for run in runs[policy]]) for policy in POLICIES)
        apart = over_courses(ours - other)
        for policy, errors in zip(POLICIES, (ours, other), strict=True):
            lost = f"{100 * np.mean([run['lost_share'] for run in runs[policy]]):.1f} %"
            failed = f"{sum(run['failed'] for run in runs[policy])}/{len(errors)}"
            difference = apart.text("+.2f") if policy == POLICIES[0] else ""
            rows.append([f"{title}: `{policy}`", f"{errors.mean():.2f}", lost, failed, difference])
    caption = "ORB-SLAM3; RPE over 20 mm, the difference to `begin2022` paired by room, both in mm."
    return Section(_SETTING, [], [Table(caption, ["", "RPE mean", "pairs lost", "runs failed", "difference"], rows)])


EXPERIMENT = Experiment("orbslam3", "Fig. 13 with ORB-SLAM3, a few courses, where it is installed", jobs, section)
