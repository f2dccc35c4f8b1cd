"""Laps driven by registrations alone: each exposure policy teaches a path and repeats it in every light."""

from __future__ import annotations

import math
from typing import Any

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import Plain
from evaluation.experiments.navigation.lap import PERIOD_S, SPEED_M_S, Lap, Repeater, taught
from evaluation.experiments.teach.path import TaughtPath

POLICIES = (DEFAULT_POLICY, "fixed", "majer2018-standard", "begin2022", "begin2022-code")

ASIDE_M, TURNED_RAD = 0.3, math.radians(5.0)
"""Where the robot starts beside the path."""

LOST_M = 1.0
"""A lap that was not completed counts as this far aside."""

AT_MOST_M = 0.1
"""How far aside a robot may be at the end of a lap."""


def measure_laps(seed: int, policy: str, light: str, laps: int) -> list[dict[str, Any]]:
    """Repeat a path in one light, lap after lap, until one is not completed: a row for each of the laps."""
    path = TaughtPath(seed, 0.0)
    lesson = taught(path, seed, policy, path.length_m)
    repeater = Repeater(lesson, light, policy, aside_m=ASIDE_M, turned_rad=TURNED_RAD)
    rows = [_row(repeater.lap())]
    while rows[-1]["completed"] and len(rows) < laps:
        rows.append(_row(repeater.lap()))
    return rows


def _row(lap: Lap) -> dict[str, Plain]:
    return {
        "completed": lap.completed,
        "stop": str(lap.stop),
        "end_m": float(lap.aside_m[-1]) if lap.completed else LOST_M,
        "mean_m": float(lap.aside_m.mean()),
        "max_m": float(lap.aside_m.max()),
        "registered": float(lap.registered.mean()),
        "driven_m": SPEED_M_S * PERIOD_S * len(lap.aside_m),
    }
