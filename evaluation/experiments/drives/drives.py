"""Drives through rooms: the error of odometry with fixed settings, and with policies in closed loop."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.metrics.published import (
    CombinedQuality,
    entropy,
    entropy_weighted_gradient,
    median_gradient,
)
from autoexpose_daemon.control.picture.image import ImagePreparation
from evaluation.arrays import Floats
from evaluation.committed import FURNISHED_ROOMS
from evaluation.experiments.experiment import Claim, Verdict
from evaluation.intervals import FEWEST, Interval, mean_interval
from evaluation.jobs.job import Plain
from evaluation.odometry.features import StereoMatcher
from evaluation.odometry.orb import in_house
from evaluation.odometry.orb_slam3 import OrbSlam3, silent, write_taught_vocabulary
from evaluation.odometry.stereo import StereoCamera, images, prepared
from evaluation.odometry.tracking import Light, odometry_stage, outcome, track_entrants
from evaluation.stage.camera import Entrant
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import FrameSet
from imaging.response import ResponseFunction

PROXIES: dict[str, float | None] = {
    "gradient information": -0.73, "median gradient": -0.37, "entropy": 0.26, "entropy-weighted gradient": -0.40,
    "combined quality": -0.26, "good stereo matches": 0.02, "Lowe ratio": -0.73, "gradient information, no gamma": None,
}  # fmt: skip
"""In the order of Fig. 9, with the paper's correlation with the error, and one that is not in the paper."""


class Proxies:
    """Measures pairs as odometry gets them, median and gamma of 0.3 first, as the paper did. Five measures use the left
    image at control's size; the last one uses it as control sees it."""

    def __init__(self) -> None:
        self._preparation = ImagePreparation()
        self._gradient, self._quality = GradientMetric(), CombinedQuality()
        self._matcher = StereoMatcher()

    def measure(self, pair: FrameSet) -> list[float]:
        """One value for each of `PROXIES`; a Lowe ratio of 1 stands for no match."""
        left, right = images(pair)
        image = self._preparation.prepare(left)
        matches = self._matcher.match(left, right)
        lowe = matches.median_lowe_ratio
        return [
            self._gradient.measure(image), median_gradient(image), entropy(image), entropy_weighted_gradient(image),
            self._quality.measure(image), float(matches.count), 1.0 if lowe is None else lowe,
            self._gradient.measure(self._preparation.prepare(pair.reference.grey8())),
        ]  # fmt: skip


# Exposure time (us) and gain (dB), all at one exposure level, right for 20 lux.
SETTINGS = ((940.0, 24.0), (1880.0, 18.0), (3750.0, 12.0), (7500.0, 6.0))
LOOK_EVERY = 8  # Images of every eighth pair that odometry gets are measured


def measure_fixed(room: int, seed: int, repeat: int, frames: int) -> Plain:
    """For each setting, what `outcome` returns, and the medians of the measures of images."""
    entrants = [Entrant(f"{time_us:g} us", 2, partial(_fixed_loop, time_us, gain_db)) for time_us, gain_db in SETTINGS]
    looks: list[list[list[float]]] = [[] for _ in SETTINGS]
    stage = odometry_stage("even", room, seed, repeat)
    runs = track_entrants(stage, entrants, in_house, frames, _looker(looks, Proxies().measure, LOOK_EVERY))
    return [
        {**outcome(one), "proxies": np.median(seen, axis=0).tolist()} for one, seen in zip(runs, looks, strict=True)
    ]


def _fixed_loop(
    time_us: float, gain_db: float, response: ResponseFunction, limits: ExposureLimits, _start: ExposureSetting
) -> ControlLoop:
    return ControlLoop("fixed", response, limits, ExposureSetting(time_us, gain_db))


def _looker(
    seen: list[list[Any]], measure: Callable[[FrameSet], Any], every: int = 1
) -> Callable[[int, FrameSet], None]:
    """Adds what is measured of every so many pairs of an entrant to `seen`."""
    shown = [0] * len(seen)

    def look(number: int, pair: FrameSet) -> None:
        if shown[number] % every == 0:
            seen[number].append(measure(pair))
        shown[number] += 1

    return look


# Chosen by hand: of 1.5, 3 and 6 ms with 6, 12, 18 and 24 dB, it had the smallest error over two laps of room 1 in
# uneven light, and lost no pair. Room 1 is not in the report.
FIXED = ExposureSetting(3000.0, 6.0)


def measure_policies(
    *, light: Light, lens_f_number: float, room: int, seed: int, repeat: int, policies: list[str], frames: int
) -> Plain:
    """For each policy, what `outcome` returns, and `metric_after_gamma`: median M_g of what odometry gets."""
    stage = odometry_stage(light, room, seed, repeat, lens_f_number)
    seen: list[list[float]] = [[] for _ in policies]
    preparation, metric = ImagePreparation(), GradientMetric()

    def measure(pair: FrameSet) -> float:
        return metric.measure(preparation.prepare(prepared(pair.reference.grey8())))

    runs = track_entrants(stage, [entrant(policy) for policy in policies], in_house, frames, _looker(seen, measure))
    return [{**outcome(one), "metric_after_gamma": float(np.median(of))} for one, of in zip(runs, seen, strict=True)]


def entrant(policy: str) -> Entrant:
    """A policy as it runs here."""
    return Entrant(policy, 2, partial(_loop, policy))


def _loop(policy: str, response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
    return ControlLoop(policy, response, limits, FIXED if policy == "fixed" else start)


def measure_orb_slam3(*, light: Light, room: int, seed: int, policy: str, frames: int, version: str) -> Plain:
    """What `outcome` returns. The package's `version` only keeps results of different versions apart."""
    with tempfile.TemporaryDirectory() as name, silent():
        folder = Path(name)
        write_taught_vocabulary(folder / "vocabulary.txt")
        with closing(OrbSlam3(StereoCamera.simulated(), folder / "vocabulary.txt", folder)) as slam:
            (one,) = track_entrants(odometry_stage(light, room, seed, 0), [entrant(policy)], lambda: slam, frames)
    return outcome(one)


# Rooms of full runs, each driven through once: its number is also the seed of its heading, so that no two courses share
# anything.
ROOMS = FURNISHED_ROOMS
FEWEST_ROOMS = FEWEST  # With fewer, draws say too little about the spread between rooms
# Errors that differ by less are alike: so much do two runs of one policy differ that differ in noise alone.
ALIKE_MM = 0.1


def over_rooms(values: Floats) -> Interval:
    """Mean of one value for each room with its 95 % interval, which is unbounded for too few rooms."""
    if len(values) < FEWEST_ROOMS:
        return Interval(float(values.mean()), -math.inf, math.inf)
    return mean_interval(values)


def unless_few(claims: Sequence[Claim], rooms: int) -> list[Claim]:
    """The claims as judged; undecided where there were too few rooms."""
    if rooms >= FEWEST_ROOMS:
        return list(claims)
    return [replace(claim, verdict=Verdict.UNDECIDED, condition="too few rooms") for claim in claims]
