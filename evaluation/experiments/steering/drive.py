"""Odometry that steers the exposure of its own frames, beside odometry that does not."""

from __future__ import annotations

import numpy as np

from autoexpose_daemon.control.picture.tracked_cells import count_by_cell
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import Plain
from evaluation.experiments.steering.consumers import Cells, Steered
from evaluation.odometry.lap import Light, odometry_stage
from evaluation.odometry.orb import in_house
from evaluation.odometry.stereo import images
from evaluation.odometry.tracking import EVERY, outcome, track_entrants
from evaluation.stage.delayed_loop import Entrant
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

NAMES = ("alone", "steered")


class OdometryConsumer:
    """The in-house odometry."""

    def __init__(self) -> None:
        self._odometry = in_house()

    def track(self, pair: StereoPair) -> tuple[Cells, Cells]:
        """See `Consumer`."""
        self._odometry.track(*images(pair))
        height, width = pair.reference.pixels.shape
        features = count_by_cell(self._odometry.features_px, width, height)
        return features, np.minimum(count_by_cell(self._odometry.inliers_px, width, height), features)


def measure_drive(*, light: Light, room: int, frames: int) -> Plain:
    """For each of `NAMES`: error of odometry, lost pairs, and how many points tie a pair to the last key pair."""
    entrants = [Entrant.of(DEFAULT_POLICY), Entrant("steered", 2, _steered)]
    inliers: list[list[int]] = [[] for _ in entrants]

    def look(number: int, _pair: StereoPair) -> None:
        inliers[number].append(len(odometries[number].inliers_px))

    odometries = [in_house() for _ in entrants]
    waiting = iter(odometries)
    made = track_entrants(odometry_stage(light, room, room, 0), entrants, lambda: next(waiting), frames, look)
    return [
        {key: outcome(one)[key] for key in ("rpe_mm", "lost_share", "failed", "metric")}
        | {"inliers": float(np.mean(of)), "level": float(np.mean([each.level for each in one.delayed.settings]))}
        for one, of in zip(made, inliers, strict=True)
    ]


def _steered(response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> Steered:
    return Steered(OdometryConsumer(), EVERY, response, limits, start)
