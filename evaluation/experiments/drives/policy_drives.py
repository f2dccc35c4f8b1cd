"""The error of odometry with each policy in closed loop, side by side."""

from __future__ import annotations

from functools import partial

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import ControlParameters
from calibration.response import ResponseFunction
from drivers.exposure import ExposureLimits, ExposureSetting
from evaluation.experiments.experiment import Plain
from evaluation.odometry.lap import Light, odometry_stage
from evaluation.odometry.orb import in_house
from evaluation.odometry.tracking import outcome, track_entrants
from evaluation.stage.delayed_loop import Entrant

FIXED = ExposureSetting(3000.0, 6.0)
"""Chosen by hand: of 1.5, 3 and 6 ms with 6, 12, 18 and 24 dB, it had the smallest error over two laps of room 1 in
uneven light, and lost no pair. Room 1 is not in the report."""


def measure(*, light: Light, room: int, seed: int, repeat: int, policies: list[str], frames: int) -> Plain:
    """What `outcome` returns for each policy."""
    stage = odometry_stage(light, room, seed, repeat)
    runs = track_entrants(stage, [entrant(policy) for policy in policies], in_house, frames)
    return [outcome(one) for one in runs]


def entrant(policy: str) -> Entrant:
    """A policy as it runs here."""
    return Entrant(policy, 2, partial(_loop, policy))


def _loop(policy: str, response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
    balance = ControlParameters(balance="blur_noise" if policy == "shim2018" else "policy")
    return ControlLoop(policy, response, limits, FIXED if policy == "fixed" else start, balance)
