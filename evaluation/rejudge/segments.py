"""A drive in segments of ten seconds, each policy through each: small pure jobs, whose results are plain."""

from __future__ import annotations

import base64
import shlex
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from evaluation.arrays import Greys
from evaluation.jobs.job import Job, Plain
from evaluation.jobs.kept import content
from evaluation.rejudge.contest import (
    Figures,
    NothingTrackedError,
    Outcome,
    Round,
    first_setting,
    follow_best_shots,
    play,
)
from evaluation.rejudge.decide import SEGMENT_S, SeenSegment
from evaluation.rejudge.drive import Drive
from evaluation.rejudge.following import IN_HOUSE, ORB_SLAM3, ReferenceTrajectory, Trajectory, read_tum
from evaluation.rejudge.sources import MarkedPair, Part, Survey, read_drive
from imaging.errors import AutoexposeError, ConfigurationError

WIDTH = 240  # Of a picture, pixels
PAIR_S = 0.022  # of one core for a policy and pair of 720x540: 1.3 times the length of a drive at 60 Hz


def survey_job(drive: Path) -> Job:
    """What is known of a drive before its pictures are looked at; or why it is refused."""
    return Job(survey, {"drive": str(drive)}, 10.0, policies=(), files=("drive",))


def survey(drive: str) -> Plain:
    """A `Survey`, or `refused` in a sentence."""
    try:
        found = asdict(Survey.of(Path(drive)))
        if not found["times_s"]:
            raise AutoexposeError(f"{drive}: has no complete pairs: record the drive with both cameras open")
    except AutoexposeError as error:
        return {"refused": str(error)}
    return found


def parts_of(times_s: Sequence[float], fewest: int = 1) -> list[Part]:
    """The segments of a drive by its pairs' times, longer where they had fewer pairs; the last is up to half as long
    again."""
    numbers = ((np.asarray(times_s) - times_s[0]) / SEGMENT_S).astype(int)
    if len(times_s) > 1 and (times_s[-1] - times_s[0]) % SEGMENT_S < SEGMENT_S / 2 and numbers[-1] > 0:
        numbers[numbers == numbers[-1]] -= 1
    starts = [0]
    for start in (np.flatnonzero(np.diff(numbers)) + 1).tolist():
        if min(start - starts[-1], len(times_s) - start) >= fewest:
            starts.append(start)
    return list(pairwise([*starts, len(times_s)]))


def segment_jobs(
    drive: Path,
    part: Part,
    policies: Sequence[str],
    odometry: str,
    trajectory: Path | None,
    *,
    near: MarkedPair | None,
) -> list[Job]:
    """One for each policy through a segment. `near`: a mark of the recording before it."""
    arguments: dict[str, Plain] = {
        "drive": str(drive), "first": part[0], "end": part[1], "near": near and [near[0], near[1], list(near[2])],
        "odometry": odometry,
        "trajectory": None if trajectory is None else str(trajectory), "program": _program(odometry),
    }  # fmt: skip
    files = ("drive",) if trajectory is None else ("drive", "trajectory")
    cost_s = PAIR_S * (part[1] - part[0])
    return [Job(measure_segment, arguments, cost_s, (policy,), side_by_side=True, files=files) for policy in policies]


def _program(odometry: str) -> list[Plain]:
    """What is in the files that a command names."""
    words = [] if odometry in (IN_HOUSE, ORB_SLAM3) else shlex.split(odometry)
    return [content(Path(word)) for word in words if Path(word).is_file()]


def measure_segment(
    drive: str,
    *,
    first: int,
    end: int,
    near: MarkedPair | None,
    odometry: str,
    trajectory: str | None,
    program: Sequence[str],
    policies: Sequence[str],
) -> list[Plain]:
    """For each policy its figures, levels, and pictures, and what is known of the segment.

    Raises AutoexposeError in words for the user.
    """
    segment = read_drive(Path(drive), (first, end), near)
    unfollowed: str | None = None
    with tempfile.TemporaryDirectory(prefix="autoexpose-rejudge-") as folder:
        truth = None if trajectory is None else read_tum(Path(trajectory))
        if truth is not None:
            _check_fits(truth, segment, trajectory)
        else:
            try:
                truth = follow_best_shots(segment, odometry, Path(folder))
            except NothingTrackedError as error:
                unfollowed = str(error)
        reference = None if truth is None else ReferenceTrajectory.of(truth, segment.timeline.cycle_s)
        outcomes = play(Round(segment, policies, odometry, reference, Path(folder)))
    about = _about(segment) | {"unfollowed": unfollowed}
    return [_plain(outcome, about) for outcome in outcomes]


def _check_fits(truth: Trajectory, drive: Drive, path: str | None) -> None:
    """Raise a ConfigurationError for a trajectory of another time."""
    glimpses = drive.timeline.glimpses
    known = sum(truth.at(glimpse.time_s) is not None for glimpse in glimpses)
    if known < len(glimpses) / 2:
        raise ConfigurationError(
            f"{path}: covers {known} of the {len(glimpses)} pairs of the drive: its times are "
            f"{truth.times_s[0]:.3f} to {truth.times_s[-1]:.3f} s, those of the drive {glimpses[0].time_s:.3f} to "
            f"{glimpses[-1].time_s:.3f} s"
        )


def _about(drive: Drive) -> dict[str, Any]:
    timeline = drive.timeline
    return {
        "pairs": len(timeline.glimpses), "seconds": drive.seconds, "cycle": timeline.cycle, "missing": drive.missing,
        "delay_frames": drive.delay_frames, "still_share": sum(timeline.still) / len(timeline.still),
        "cycle_motion_px": timeline.cycle_motion_px, "jumps": timeline.sections[-1],
        "calibrated": len(drive.geometries) > 1, "limits": asdict(drive.setup.limits),
        "start": asdict(first_setting(drive)),
    }  # fmt: skip


def _plain(outcome: Outcome, about: dict[str, Any]) -> Plain:
    return {
        "figures": asdict(outcome.figures),
        "levels": [round(level, 3) for level in outcome.levels],
        "pictures": [_jpeg(picture) for picture in outcome.pictures],
        "captions": list(outcome.captions),
        "about": about,
    }


def _jpeg(picture: Greys) -> str:
    height = round(WIDTH * picture.shape[0] / picture.shape[1])
    small = cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA)
    return base64.b64encode(cv2.imencode(".jpg", small)[1].tobytes()).decode()


def seen(drive: str, number: int, result: Any) -> SeenSegment:
    """What decides, of a result."""
    figures = result["figures"]
    return SeenSegment(drive, number, figures["rpe_mm"], figures["lost_share"], figures["matches"])


def together(results: Sequence[Any]) -> Figures:
    """The figures of a policy over several segments: means by pairs, medians of medians."""
    figures = [Figures(**each["figures"]) for each in results]
    pairs = [each["about"]["pairs"] for each in results]

    def mean(name: str) -> float | None:
        every = [(getattr(one, name), count) for one, count in zip(figures, pairs, strict=True)]
        known = [(value, count) for value, count in every if value is not None]
        return sum(value * count for value, count in known) / sum(count for _, count in known) if known else None

    means: dict[str, Any] = {name: mean(name) for name in _MEANS}
    return replace(
        figures[0],
        **means,
        rpe_parts_mm=[part for one in figures for part in one.rpe_parts_mm],
        exposure_time_us=float(np.median([one.exposure_time_us for one in figures])),
        gain_db=float(np.median([one.gain_db for one in figures])),
    )


_MEANS = ("metric", "saturated_share", "black_share", "matches", "rpe_mm", "lost_share", "far_share", "blur_ratio")
