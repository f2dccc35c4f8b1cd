"""One policy in closed loop through a recorded drive, and what its frames are worth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import REFERENCE_RATE_HZ, ControlLoop, ControlSetup
from autoexpose_daemon.control.step import StepInputs
from evaluation.odometry.stereo_matching import StereoMatcher
from evaluation.rejudge.camera import FAR_STOPS, Made
from evaluation.rejudge.following import Followed, Follower
from evaluation.rejudge.rectify import Rectifier
from evaluation.rejudge.trajectory import Reference
from imaging.exposure import ExposureSetting
from imaging.frames import StereoPair

FOCAL_LENGTH_PX = 1000.0
"""Control is told the speed of the image as an angular rate and a focal length; any will do."""

FEWEST_BETWEEN = 2
"""Odometry gets at most every second pair."""


class Cameras(Protocol):
    """Cameras that show what there was at an instant, whatever the exposure."""

    def take(self, setting: ExposureSetting) -> Made:
        """The pair of the present instant."""
        ...


@dataclass(frozen=True, slots=True)
class Figures:
    """What the frames of a policy are worth; None: not known, for lack of a geometry, a second camera, or motion.

    Attributes
    ----------
    policy
        Its id.
    metric
        Mean M_g of the reference frames.
    saturated_share, black_share
        Their mean shares.
    matches
        Good stereo matches (B&H section 3.1), mean over the pairs that odometry gets.
    rpe_mm, rpe_parts_mm
        Mean translation RPE of the odometry, mm; and that of each part of the drive, None where nothing moved.
    lost_share
        Share of the pairs that it could not follow.
    exposure_time_us, gain_db
        Medians of the settings.
    far_share
        Share of the pairs for which the bracket has no shot within a stop.
    blur_ratio
        How much longer the shots were exposed than the frames they stand for, mean over the pairs.
    """

    policy: str
    metric: float
    saturated_share: float
    black_share: float
    matches: float | None
    rpe_mm: float | None
    rpe_parts_mm: list[float | None]
    lost_share: float | None
    exposure_time_us: float
    gain_db: float
    far_share: float
    blur_ratio: float


@dataclass(slots=True, eq=False)
class Judge:
    """Judges pairs for what odometry could do with them.

    Attributes
    ----------
    rectifier
        Of the cameras; None: their geometry is not known.
    follower
        None: nobody follows.
    """

    rectifier: Rectifier | None
    follower: Follower | None
    matches: list[int] = field(default_factory=list)
    _matcher: StereoMatcher = field(default_factory=StereoMatcher)

    def look(self, pair: StereoPair, time_s: float) -> None:
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
    """One policy on its way through a drive.

    Parameters
    ----------
    setup
        What its loop is built from, with a start.
    delay_frames
        A decision shows this many pairs later.
    judge
        Judges some of its pairs.
    told_motion
        Whether it is told how fast the image moves; else it finds out by flow.
    """

    def __init__(self, setup: ControlSetup, delay_frames: int, judge: Judge, *, told_motion: bool = True) -> None:
        parameters = replace(setup.parameters, focal_length_px=FOCAL_LENGTH_PX)
        self.loop: ControlLoop = replace(setup, parameters=parameters).loop()
        self.loop.metric_asked = True
        self.judge = judge
        self._told = told_motion
        self.settings = [setup.start] * delay_frames
        self.decisions: list[Decision] = []
        self._far = 0
        self._blur: list[float] = []
        self._judged = -FEWEST_BETWEEN
        self._shown = -1

    def step(self, number: int, cameras: Cameras, motion_px: float, *, due: bool) -> Made:
        """Take the pair of an instant, decide on it, and have it judged if it shows something new.

        Parameters
        ----------
        number
            Of the instant.
        cameras
            At that instant.
        motion_px
            Speed of the image, pixels per 1/60 s.
        due
            Whether to judge a pair that shows nothing new in motion, since several shots were fused.
        """
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

    def end(self, reference: Reference | None) -> Figures:
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
