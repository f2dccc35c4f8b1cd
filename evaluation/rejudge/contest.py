"""All policies through one drive, and which of them to take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from evaluation.rejudge.camera import RecordedCameras
from evaluation.rejudge.drive import Drive
from evaluation.rejudge.exposing import Exposer
from evaluation.rejudge.following import Following
from evaluation.rejudge.rectify import Rectifier
from evaluation.rejudge.run import Figures, Judge, PolicyRun
from evaluation.rejudge.trajectory import Reference, Trajectory
from imaging.errors import AutoexposeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Side

SURE = 2.0
"""An error is greater than the least one if they differ by so many standard errors, by the parts of the drive; those
that are not are alike, and more matches decide."""

LOST_MORE = 0.05
"""A policy that loses a larger share of the pairs than the best one by this is not recommended."""

PICTURES = 6
"""Instants at which pictures are kept for the report."""


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """Policies that go through the drive side by side, so that what is read of it is read once.

    Attributes
    ----------
    policies
        Their ids.
    reference
        The true trajectory, or that on the best shots; None: errors are not known.
    """

    drive: Drive
    policies: Sequence[str]
    odometry: str
    reference: Reference | None
    folder: Path


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What became of a policy: its figures, levels (stops), and pictures at `PICTURES` instants with their settings."""

    figures: Figures
    levels: Sequence[float]
    pictures: Sequence[NDArray[np.uint8]]
    captions: Sequence[str]


def play(one: Round) -> list[Outcome]:
    """Take the policies through the drive; AutoexposeError in words for the user."""
    drive = one.drive
    timeline = drive.timeline
    start = first_setting(drive)
    judge = partial(_judge, drive, one.odometry, one.folder)
    runs = [
        PolicyRun(replace(drive.setup.of_policy(policy), start=start), drive.delay_frames, judge(policy))
        for policy in one.policies
    ]
    shown = set(np.linspace(0, len(timeline.glimpses) - 1, PICTURES + 2).round().astype(int)[1:-1].tolist())
    pictures: list[list[NDArray[np.uint8]]] = [[] for _ in runs]
    captions: list[list[str]] = [[] for _ in runs]
    cameras = RecordedCameras(timeline, exposers(drive))
    for number, pair_at in drive.pairs():
        cameras.go_to(number, pair_at)
        for place, run in enumerate(runs):
            made = run.step(number, cameras, timeline.motion_px(number), due=number % timeline.cycle == 0)
            if number in shown:
                pictures[place].append(made.pair.reference.grey8())
                captions[place].append(str(made.pair.reference.setting))
    return [
        Outcome(run.end(one.reference), run.levels, seen, said)
        for run, seen, said in zip(runs, pictures, captions, strict=True)
    ]


def exposers(drive: Drive) -> dict[Side, Exposer]:
    """Those of the cameras, from their responses and their sensors' noise."""
    parameters = drive.setup.parameters
    noise = SensorNoise(parameters.full_well_e, parameters.read_noise_e)
    return {side: Exposer(response, noise, seed) for seed, (side, response) in enumerate(drive.setup.responses.items())}


def follow_best_shots(drive: Drive, odometry: str, folder: Path) -> Trajectory | None:
    """Where odometry says the camera was, on the best shot of each cycle by M_g, as it was recorded.

    None where nothing can follow, for lack of a geometry; raises AutoexposeError where odometry is lost altogether.
    """
    judge = _judge(drive, odometry, folder, "best shots")
    if judge.follower is None:
        return None
    glimpses, cycle = drive.timeline.glimpses, drive.timeline.cycle
    best = {
        max(range(first, min(first + cycle, len(glimpses))), key=lambda shot: glimpses[shot].metric)
        for first in range(0, len(glimpses), cycle)
    }
    for number, pair_at in drive.pairs():
        if number in best:
            judge.look(pair_at(number), glimpses[number].time_s)
    followed = judge.end()
    if followed is None:
        return None
    if not len(followed.trajectory.times_s):
        raise AutoexposeError(f"--odometry {odometry} tracks nothing on the best shots: give a reference, --trajectory")
    return followed.trajectory


def recommended(figures: Sequence[Figures]) -> str:
    """The policy of the least error of odometry; among those alike, or where there is none, of the most matches.

    Where nothing was matched, that of the largest metric.
    """
    least_lost = min((one.lost_share for one in figures if one.lost_share is not None), default=0.0)
    kept = [one for one in figures if (one.lost_share or 0.0) <= least_lost + LOST_MORE]
    followed = [one for one in kept if one.rpe_mm is not None]
    if followed:
        best = min(followed, key=lambda one: one.rpe_mm or 0.0)
        kept = [one for one in followed if not _worse(one, best)]
    return max(kept, key=lambda one: (one.matches or 0.0, one.metric)).policy


def _worse(one: Figures, best: Figures) -> bool:
    """Whether the errors of odometry are surely greater, part by part of the drive."""
    parts = zip(one.rpe_parts_mm, best.rpe_parts_mm, strict=True)
    apart = np.array([ours - theirs for ours, theirs in parts if ours is not None and theirs is not None])
    if len(apart) < 2:
        return False
    return bool(apart.mean() > SURE * apart.std(ddof=1) / math.sqrt(len(apart)))


def section(policy: str, limits: ExposureLimits, start: ExposureSetting) -> str:
    """What to put into the configuration, YAML: with the start, at which `fixed` stays."""
    return (
        f"control:\n  policy: {policy}\n"
        f"  start: {{exposure_time_us: {start.exposure_time_us:g}, gain_db: {start.gain_db:g}}}\n"
        f"exposure:\n  min_time_us: {limits.min_time_us:g}\n  max_time_us: {limits.max_time_us:g}\n"
        f"  min_gain_db: {limits.min_gain_db:g}\n  max_gain_db: {limits.max_gain_db:g}\n"
    )


def first_setting(drive: Drive) -> ExposureSetting:
    """Where every policy starts: the best shot of the first cycle by M_g."""
    first = drive.timeline.glimpses[: drive.timeline.cycle]
    return drive.setup.limits.nearest(max(first, key=lambda glimpse: glimpse.metric).setting)


def _judge(drive: Drive, odometry: str, folder: Path, name: str) -> Judge:
    if len(drive.geometries) < 2:
        return Judge(None, None)
    rectifier = Rectifier(drive.geometries, drive.shape)
    following = Following(odometry, rectifier.camera, drive.timeline.cycle_s, folder)
    return Judge(rectifier, following.begin(name))


def document(figures: Sequence[Figures], limits: ExposureLimits, start: ExposureSetting) -> dict[str, Any]:
    """What is written as JSON."""
    best = recommended(figures)
    rows = [{name: getattr(one, name) for name in Figures.__dataclass_fields__} for one in figures]
    return {"policies": rows, "recommended": best, "section": section(best, limits, start)}
