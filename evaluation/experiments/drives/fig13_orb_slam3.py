"""Part of Fig. 13 with ORB-SLAM3, the paper's odometry, where it is installed."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.drives.drives import ROOMS, measure_orb_slam3
from evaluation.experiments.drives.fig12 import LAWS, LOW, UNEVEN
from evaluation.experiments.experiment import Experiment, Job, Results, Section, Table
from evaluation.odometry.orb_slam3 import PACKAGE, installed
from evaluation.scenes.scenarios import RATE_HZ

POLICIES = (DEFAULT_POLICY, *LAWS)
FEW_ROOMS = ROOMS[:3]
_ABSENT = f"`{PACKAGE}` is not installed, so nothing was measured: see docs/odometry.md."

_SETTING = f"""\
The first three rooms of fig12 with ORB-SLAM3 (`{PACKAGE}`) instead of our odometry. Its vocabulary of visual
words was made from our own frames of another room. Poses are those that it returns immediately, as a robot gets them.
It maps in its own threads, so these numbers differ from run to run. Three rooms decide nothing, and have no interval:
the numbers are for comparison with those of our odometry."""


def jobs(quick: bool) -> list[Job]:
    """One for each light, room and policy; none if ORB-SLAM3 is not installed."""
    if not installed():
        return []
    rooms, seconds = ((2,), 1.7) if quick else (FEW_ROOMS, 8.0)
    return [
        Job(
            measure_orb_slam3,
            {
                "light": scene.light, "room": room, "seed": room, "policy": policy, "frames": round(seconds * RATE_HZ),
                "version": version(PACKAGE),
            },
            cost_s=10.0 + 5.0 * seconds,
        )
        for scene in (UNEVEN, LOW)
        for room in rooms
        for policy in POLICIES
    ]  # fmt: skip


def section(results: Results, _folder: Path) -> Section:
    """A table only: so few courses judge no claim."""
    if not results:
        return Section(_ABSENT, [], [])
    rows = []
    for scene in (UNEVEN, LOW):
        of_light = [(case["policy"], one) for case, one in results if case["light"] == scene.light]
        runs = {policy: [one for name, one in of_light if name == policy] for policy in POLICIES}
        errors = {policy: np.array([run["rpe_mm"] for run in of]) for policy, of in runs.items()}
        for policy, of in runs.items():
            lost = f"{100 * np.mean([run['lost_share'] for run in of]):.1f} %"
            failed = f"{sum(run['failed'] for run in of)}/{len(of)}"
            apart = ", ".join(f"{by:+.2f}" for by in errors[DEFAULT_POLICY] - errors[policy])
            difference = "" if policy == DEFAULT_POLICY else apart
            rows.append([f"{scene.title}: `{policy}`", f"{errors[policy].mean():.2f}", lost, failed, difference])
    caption = f"ORB-SLAM3; RPE over 20 mm, and that of `{DEFAULT_POLICY}` minus it in each room, in mm."
    heads = ["", "RPE mean", "pairs lost", "runs failed", f"`{DEFAULT_POLICY}` minus it"]
    return Section(_SETTING, [], [Table(caption, heads, rows)])


EXPERIMENT = Experiment("orbslam3", "Fig. 13 with ORB-SLAM3, a few courses, where it is installed", jobs, section)
