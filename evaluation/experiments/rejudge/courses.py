"""The courses: laps through rooms for odometry, and the arena's scenarios for the light."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from autoexpose_daemon.control.parameters import Bracketing
from evaluation.arena.race import course_of
from evaluation.experiments.rejudge.rehearsal import Compared, driven, record, rejudged, truth
from evaluation.odometry.lap import Light, odometry_stage
from evaluation.rejudge.contest import exposers
from evaluation.rejudge.exposing import Exposer
from evaluation.rejudge.exposing import Light as LightSeen
from evaluation.rejudge.trajectory import Reference
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import Image, time_first
from evaluation.stage.rendering import Stage
from imaging.exposure import ExposureSetting

OFFSETS = tuple(range(-4, 5))
"""Stops from the middle of the bracket at which emulated frames are compared with true ones."""

APART = (0, 14, 21)
"""Frames before the last at which the light is found: in cycles that share no shot."""

REPEATS = 12
"""Frames of one exposure, whose mean tells the error from the noise."""


def measure_lap(*, light: Light, room: int, frames: int, policies: list[str]) -> dict[str, Any]:
    """Policies on one lap through a room, rejudged, driven, and driven again with other noise."""
    stage = odometry_stage(light, room, room, 0)
    drive = record(stage, frames, Bracketing())
    reference = Reference.of(truth(stage, frames / RATE_HZ), drive.timeline.cycle_s)
    again = driven(odometry_stage(light, room, room, 1), drive, policies, reference)
    return _both(rejudged(drive, policies, reference), driven(stage, drive, policies, reference), again)


def measure_scenario(*, scenario: str, scene: str, seed: int, frames: int, policies: list[str]) -> dict[str, Any]:
    """Policies in one course of the arena, rejudged and driven; nobody follows the camera."""
    stage, _ = course_of(scenario, scene, seed)
    drive = record(stage, frames, Bracketing())
    figures = _both(rejudged(drive, policies, None), driven(stage, drive, policies, None))
    jump = next((number for number in range(1, frames) if drive.timeline.sections[number]), None)
    return figures | {"jump": jump}


def measure_still(*, scene: str, seed: int, frames: int) -> list[dict[str, float]]:
    """Frames of a still scene, emulated and true, at each of `OFFSETS`."""
    stage, _ = course_of("step_up", scene, seed)
    drive = record(stage, frames, Bracketing())
    last = max(number for number, still in enumerate(drive.timeline.still) if still)
    exposer, wanted = exposers(drive)["left"], {last - back for back in APART}
    lights = [
        exposer.fused([pair_at(shot).frames["left"] for shot in drive.timeline.around(number)])
        for number, pair_at in drive.pairs()
        if number in wanted
    ]
    middle = float(np.mean([drive.timeline.glimpses[shot].level for shot in drive.timeline.around(last)]))
    return [{"offset": float(offset), **_compared(stage, exposer, lights, middle + offset)} for offset in OFFSETS]


def _compared(stage: Stage, exposer: Exposer, lights: list[LightSeen], level: float) -> dict[str, float]:
    """Mean error of emulated frames, rms of what does not average out, their noise and that of true ones; grey levels.

    `lights` were seen at different times, so that their own noise averages out, too.
    """
    setting = time_first(level)
    true = np.array([_at(stage, number, setting) for number in range(100, 100 + REPEATS)], np.float64)
    made = np.array(
        [
            [exposer.expose(light, setting, 8, place * REPEATS + number) for number in range(REPEATS)]  # no noise twice
            for place, light in enumerate(lights)
        ],
        np.float64,
    )
    means, true_variance = made.mean(axis=1), float(true.var(axis=0, ddof=1).mean())
    of_light, added = float(means.var(axis=0, ddof=1).mean()), float(made.var(axis=1, ddof=1).mean())
    apart = float(((means.mean(axis=0) - true.mean(axis=0)) ** 2).mean())
    return {
        "bias": float(made.mean() - true.mean()),
        "rms": math.sqrt(max(apart - of_light / len(lights) - true_variance / REPEATS, 0.0)),
        "made_noise": math.sqrt(max(of_light - added / REPEATS, 0.0) + added),
        "noise": math.sqrt(true_variance),
    }


def _at(stage: Stage, number: int, setting: ExposureSetting) -> Image:
    stage.frame = number  # the noise of another frame of the same view
    return stage.expose("left", setting).copy()


def _both(ours: list[Compared], true: list[Compared], again: list[Compared] | None = None) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for place, (one, other) in enumerate(zip(ours, true, strict=True)):
        levels = [[round(level, 3) for level in each.levels] for each in (one, other)]
        row = {"rejudged": asdict(one.figures), "driven": asdict(other.figures), "levels": levels}
        found[one.figures.policy] = row if again is None else {**row, "again": asdict(again[place].figures)}
    return found
