"""The error of odometry with each of a few fixed settings, and measures of its images."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from evaluation.experiments.experiment import Plain
from evaluation.odometry.lap import odometry_stage
from evaluation.odometry.orb import in_house
from evaluation.odometry.proxies import Proxies
from evaluation.odometry.tracking import outcome, track_entrants
from evaluation.stage.delayed_loop import Entrant
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

SETTINGS = ((940.0, 24.0), (1880.0, 18.0), (3750.0, 12.0), (7500.0, 6.0))
"""Exposure time (us) and gain (dB), all at one exposure level, right for 20 lux."""

LOOK_EVERY = 8
"""Images of every eighth pair that odometry gets are measured."""


def measure(room: int, seed: int, repeat: int, frames: int) -> Plain:
    """For each setting, what `outcome` returns, and the medians of the measures of images."""
    entrants = [Entrant(f"{time_us:g} us", 2, partial(_fixed, time_us, gain_db)) for time_us, gain_db in SETTINGS]
    looks: list[list[list[float]]] = [[] for _ in SETTINGS]
    stage = odometry_stage("even", room, seed, repeat)
    runs = track_entrants(stage, entrants, in_house, frames, _looker(looks))
    return [
        {**outcome(one), "proxies": np.median(seen, axis=0).tolist()} for one, seen in zip(runs, looks, strict=True)
    ]


def _fixed(
    time_us: float, gain_db: float, response: ResponseFunction, limits: ExposureLimits, _start: ExposureSetting
) -> ControlLoop:
    return ControlLoop("fixed", response, limits, ExposureSetting(time_us, gain_db))


def _looker(looks: list[list[list[float]]]) -> Callable[[int, StereoPair], None]:
    proxies = Proxies()
    shown = [0] * len(looks)

    def look(number: int, pair: StereoPair) -> None:
        if shown[number] % LOOK_EVERY == 0:
            looks[number].append(proxies.measure(pair))
        shown[number] += 1

    return look
