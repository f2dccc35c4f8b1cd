"""Policies in closed loop through a drive, and what their frames are worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import REFERENCE_RATE_HZ, ControlLoop
from autoexpose_daemon.control.metrics.contrast import SensorNoise
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.step import StepInputs
from evaluation.arrays import Greys
from evaluation.odometry.features import StereoMatcher
from evaluation.rejudge.camera import FAR_STOPS, Exposer, Made, RecordedCameras, Rectifier
from evaluation.rejudge.contender import LimitedPolicy
from evaluation.rejudge.drive import Drive
from evaluation.rejudge.following import Followed, Follower, Following, ReferenceTrajectory, Trajectory
from imaging.errors import AutoexposeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, FrameSet

FOCAL_LENGTH_PX = 1000.0  # Control is told the speed of the image as an angular rate and a focal length; any will do
FEWEST_BETWEEN = 2  # Odometry gets at most every second pair


class NothingTrackedError(AutoexposeError):
    """Odometry is lost on the best shots from the first to the last."""


class InstantCameras(Protocol):
    """Cameras that show what there was at an instant, whatever the exposure."""

    def take(self, setting: ExposureSetting) -> Made:
        """The pair of the present instant."""
        ...


@dataclass(frozen=True, slots=True)
class Figures:
    """What the frames of a policy are worth; None: not known, for lack of a geometry, a second camera, or motion."""

    policy: str  # its id, or the name of a contender
    metric: float  # mean M_g of the reference frames
    # saturated_share, black_share: their mean shares.
    saturated_share: float
    black_share: float
    matches: float | None  # good stereo matches (B&H section 3.1), mean over the pairs that odometry gets
    # rpe_mm, rpe_parts_mm: mean translation RPE of the odometry, mm; and that of each part of the drive, None where
    # nothing moved.
    rpe_mm: float | None
    rpe_parts_mm: list[float | None]
    lost_share: float | None  # share of the pairs that it could not follow
    # exposure_time_us, gain_db: medians of the settings.
    exposure_time_us: float
    gain_db: float
    far_share: float  # share of the pairs for which the bracket has no shot within a stop
    blur_ratio: float  # how much longer the shots were exposed than the frames they stand for, mean over the pairs


@dataclass(slots=True, eq=False)
class PairJudge:
    """Judges pairs for what odometry could do with them."""

    rectifier: Rectifier | None  # of the cameras; None: their geometry is not known
    follower: Follower | None  # None: nobody follows
    matches: list[int] = field(default_factory=list)
    _matcher: StereoMatcher = field(default_factory=StereoMatcher)

    def look(self, pair: FrameSet, time_s: float) -> None:
        """The next pair, and when its reference frame was taken."""
        if self.rectifier is None or len(pair.frames) < 2:
            return
        left, right = self.rectifier.images(pair)
        self.matches.append(self._matcher.match(left, right).count)
        if self.follower is not None:
            self.follower.look(left, right, time_s)

    def end(self) -> Followed | None:
        """After the last pair."""
        return self.follower.end() if self.follower is not None and self.matches else None


class PolicyRun:
    """One policy on its way through a drive. `setup`: what its loop is built from, with a start. `delay_frames`: a
    decision shows this many pairs later. `told_motion`: whether it is told how fast the image moves; else it finds out
    by flow."""

    def __init__(self, setup: ControlSetup, delay_frames: int, judge: PairJudge, *, told_motion: bool = True) -> None:
        parameters = replace(setup.parameters, focal_length_px=FOCAL_LENGTH_PX)
        self.loop = ControlLoop(replace(setup, parameters=parameters))
        self.loop.metric_asked = True
        self.judge = judge
        self._told = told_motion
        self.settings = [setup.start] * delay_frames
        self.decisions: list[Decision] = []
        self._far = 0
        self._blur: list[float] = []
        self._judged = -FEWEST_BETWEEN
        self._shown = -1

    def step(self, number: int, cameras: InstantCameras, motion_px: float, *, due: bool) -> Made:
        """Take the pair of an instant, decide on it, and have it judged if it shows something new. `motion_px`: speed
        of the image, pixels per 1/60 s. `due`: whether to judge a pair that shows nothing new in motion, since several
        shots were fused."""
        made = cameras.take(self.settings[len(self.decisions)])
        rate_rad_s = motion_px * REFERENCE_RATE_HZ / FOCAL_LENGTH_PX if self._told else None
        self.decisions.append(self.loop.step(StepInputs(made.pair, rate_rad_s)))
        self.settings.append(self.decisions[-1].setting)
        self._far += abs(made.off_stops) > FAR_STOPS
        self._blur.append(made.blur_ratio)
        if made.shot > self._shown and number >= self._judged + FEWEST_BETWEEN and (due or not made.fused):
            self._judged, self._shown = number, made.shot
            self.judge.look(made.pair, made.time_s)
        return made

    @property
    def levels(self) -> list[float]:
        """Exposure level of each pair so far, stops."""
        return [setting.level for setting in self.settings[: len(self.decisions)]]

    def end(self, reference: ReferenceTrajectory | None) -> Figures:
        """What became of it, after the last pair; without a reference, errors are not known."""
        followed = self.judge.end()
        errors_mm = [] if reference is None or followed is None else reference.errors_mm(followed.trajectory)
        known_mm = [error_mm for error_mm in errors_mm if math.isfinite(error_mm)]
        taken = self.settings[: len(self.decisions)]
        return Figures(
            self.loop.setup.policy_id,
            metric=_mean(self.decisions, "metric"),
            saturated_share=_mean(self.decisions, "saturated_share"),
            black_share=_mean(self.decisions, "black_share"),
            matches=float(np.mean(self.judge.matches)) if self.judge.matches else None,
            rpe_mm=float(np.mean(known_mm)) if known_mm else None,
            rpe_parts_mm=[error_mm if math.isfinite(error_mm) else None for error_mm in errors_mm],
            lost_share=None if followed is None else followed.lost_share,
            exposure_time_us=float(np.median([setting.exposure_time_us for setting in taken])),
            gain_db=float(np.median([setting.gain_db for setting in taken])),
            far_share=self._far / len(taken),
            blur_ratio=float(np.mean(self._blur)),
        )


def _mean(decisions: list[Decision], name: str) -> float:
    values: NDArray[Any] = np.array([getattr(decision, name) for decision in decisions])
    return float(values.mean())


PICTURES = 3  # Instants at which pictures are kept for the report


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """Policies that go through the drive side by side, so that what is read of it is read once."""

    drive: Drive
    policies: Sequence[str]  # names of contenders
    odometry: str
    reference: ReferenceTrajectory | None  # the true trajectory, or that on the best shots; None: errors are not known
    folder: Path


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What became of a policy: its figures, levels (stops), and pictures at `PICTURES` instants with their settings."""

    figures: Figures
    levels: Sequence[float]
    pictures: Sequence[Greys]
    captions: Sequence[str]


def play(one: Round) -> list[Outcome]:
    """Take the policies through the drive; AutoexposeError in words for the user."""
    drive = one.drive
    timeline = drive.timeline
    start = first_setting(drive)
    judge = partial(_judge, drive, one.odometry, one.folder)
    runs = [
        PolicyRun(LimitedPolicy.of(policy).setup(drive.setup, start), drive.delay_frames, judge(policy))
        for policy in one.policies
    ]
    shown = set(np.linspace(0, len(timeline.glimpses) - 1, PICTURES + 2).round().astype(int)[1:-1].tolist())
    pictures: list[list[Greys]] = [[] for _ in runs]
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
        Outcome(replace(run.end(one.reference), policy=policy), run.levels, seen, said)
        for policy, run, seen, said in zip(one.policies, runs, pictures, captions, strict=True)
    ]


def exposers(drive: Drive) -> dict[CameraName, Exposer]:
    """Those of the cameras, from their responses and their sensors' noise."""
    parameters = drive.setup.parameters
    noise = SensorNoise(parameters.full_well_e, parameters.read_noise_e)
    return {
        camera: Exposer(response, noise, seed) for seed, (camera, response) in enumerate(drive.setup.responses.items())
    }


def follow_best_shots(drive: Drive, odometry: str, folder: Path) -> Trajectory | None:
    """Where odometry says the camera was, on the best shot of each cycle by M_g, as it was recorded. None where nothing
    can follow, for lack of a geometry; raises NothingTrackedError where odometry is lost altogether."""
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
        raise NothingTrackedError(
            f"--odometry {odometry} tracks nothing on the best shots: give a reference, --trajectory"
        )
    return followed.trajectory


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


def _judge(drive: Drive, odometry: str, folder: Path, name: str) -> PairJudge:
    if len(drive.geometries) < 2:
        return PairJudge(None, None)
    rectifier = Rectifier(drive.geometries, drive.shape)
    following = Following(odometry, rectifier.camera, drive.timeline.cycle_s, folder)
    return PairJudge(rectifier, following.begin(name))
