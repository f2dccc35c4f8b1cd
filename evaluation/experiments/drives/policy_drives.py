"""The error of odometry with each policy in closed loop, side by side."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import ImagePreparation
from evaluation.experiments.experiment import Plain
from evaluation.odometry.lap import Light, odometry_stage
from evaluation.odometry.orb import in_house
from evaluation.odometry.stereo import prepared
from evaluation.odometry.tracking import outcome, track_entrants
from evaluation.stage.delayed_loop import Entrant
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

FIXED = ExposureSetting(3000.0, 6.0)
"""Chosen by hand: of 1.5, 3 and 6 ms with 6, 12, 18 and 24 dB, it had the smallest error over two laps of room 1 in
uneven light, and lost no pair. Room 1 is not in the report."""


def measure(
    *, light: Light, lens_f_number: float, room: int, seed: int, repeat: int, policies: list[str], frames: int
) -> Plain:
    """For each policy, what `outcome` returns, and `metric_after_gamma`: median M_g of what odometry gets."""
    stage = odometry_stage(light, room, seed, repeat, lens_f_number)
    seen: list[list[float]] = [[] for _ in policies]
    runs = track_entrants(stage, [entrant(policy) for policy in policies], in_house, frames, _looker(seen))
    return [{**outcome(one), "metric_after_gamma": float(np.median(of))} for one, of in zip(runs, seen, strict=True)]


def _looker(seen: list[list[float]]) -> Callable[[int, StereoPair], None]:
    """Adds the metric of each left image to `seen`."""
    preparation, metric = ImagePreparation(), GradientMetric()

    def look(number: int, pair: StereoPair) -> None:
        seen[number].append(metric.measure(preparation.prepare(prepared(pair.reference.grey8()))))

    return look


def entrant(policy: str) -> Entrant:
    """A policy as it runs here."""
    return Entrant(policy, 2, partial(_loop, policy))


def _loop(policy: str, response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
    return ControlLoop(policy, response, limits, FIXED if policy == "fixed" else start)
