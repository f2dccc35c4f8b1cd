"""Simulated drives, recorded in brackets and really driven by each policy, and their courses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.setup import ControlSetup
from evaluation.arena.race import course_of
from evaluation.odometry.stereo import StereoCamera
from evaluation.odometry.tracking import Light, odometry_stage
from evaluation.rejudge.camera import Exposer, Made, Rectifier, SeenLight
from evaluation.rejudge.contest import Figures, PairJudge, PolicyRun, Round, exposers, first_setting, play
from evaluation.rejudge.drive import Drive, watched
from evaluation.rejudge.following import IN_HOUSE, Following, ReferenceTrajectory, Trajectory
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import LIMITS, DelayedLoop, Image, time_first
from evaluation.stage.rendering import Stage
from fake_camera.world.sensor import SensorModel
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting
from imaging.frames import SIDES, Side, StereoPair
from imaging.geometry import CameraGeometry
from imaging.response import ResponseFunction

DELAY_FRAMES = 2
TRUE_EVERY_S = 0.002
START = ExposureSetting(2000.0, 0.0)


@dataclass(frozen=True, slots=True)
class Compared:
    """The figures of one policy, and its levels frame by frame (stops)."""

    figures: Figures
    levels: Sequence[float]


def simulated_setup(bracketing: Bracketing) -> ControlSetup:
    """That of the simulated rig, whose noise has been calibrated."""
    sensor = SensorModel()
    parameters = ControlParameters(full_well_e=sensor.full_well_e, read_noise_e=sensor.read_noise_e, bracket=bracketing)
    responses: dict[Side, ResponseFunction] = dict.fromkeys(SIDES, ResponseFunction.linear())
    return ControlSetup("fixed", responses, LIMITS, START, parameters)


def record(stage: Stage, frames: int, bracketing: Bracketing) -> Drive:
    """Drive once in brackets; the pairs stay in memory."""
    setup = simulated_setup(bracketing)
    delayed = DelayedLoop(ControlLoop(setup), DELAY_FRAMES)
    pairs: list[StereoPair] = []
    times_s: list[float] = []
    for number in range(frames):
        stage.go_to(number)
        pair = delayed.step(stage.take)
        copies = {side: replace(frame, pixels=frame.pixels.copy()) for side, frame in pair.frames.items()}
        pairs.append(StereoPair(pair.trigger, copies))
        times_s.append(stage.start_s(number) + pair.reference.setting.exposure_time_us / 2e6)
    seen = zip(pairs, delayed.decisions, times_s, strict=True)
    return watched("rehearsal", setup, seen, lambda: iter(pairs), simulated_geometries())


def rejudged(drive: Drive, policies: Sequence[str], reference: ReferenceTrajectory | None) -> list[Compared]:
    """The policies on the recorded drive."""
    outcomes = play(Round(drive, policies, IN_HOUSE, reference, Path()))
    return [Compared(outcome.figures, outcome.levels) for outcome in outcomes]


def driven(
    stage: Stage, drive: Drive, policies: Sequence[str], reference: ReferenceTrajectory | None
) -> list[Compared]:
    """The policies on drives of their own, judged as often as the recorded one."""
    rectifier = Rectifier(drive.geometries, drive.shape)
    cycle = drive.timeline.cycle
    following = Following(IN_HOUSE, rectifier.camera, cycle / RATE_HZ, Path())
    runs = [
        PolicyRun(
            replace(drive.setup.of_policy(policy), start=first_setting(drive)),
            DELAY_FRAMES,
            PairJudge(rectifier, None if reference is None else following.begin(policy)),
            told_motion=False,
        )
        for policy in policies
    ]
    cameras = _TrueCameras(stage)
    for number in range(len(drive.timeline.glimpses)):
        stage.go_to(number)
        for run in runs:
            run.step(number, cameras, 0.0, due=number % cycle == 0)
    return [Compared(run.end(reference), run.levels) for run in runs]


def truth(stage: Stage, seconds: float) -> Trajectory:
    """Where the left camera of a room really is."""
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    times_s = np.arange(0.0, seconds + 0.1, TRUE_EVERY_S)
    return Trajectory(times_s, np.array([view.pose(float(time_s)) for time_s in times_s]))


def simulated_geometries() -> dict[Side, CameraGeometry]:
    """Those of the simulated cameras, which are rectified and do not distort."""
    camera = StereoCamera.simulated()
    focal_px, (x, y) = camera.focal_px, camera.centre_px
    k = (focal_px, 0.0, x, 0.0, focal_px, y, 0.0, 0.0, 1.0)
    unturned = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    def of(baseline_m: float) -> CameraGeometry:
        p = (focal_px, 0.0, x, -focal_px * baseline_m, 0.0, focal_px, y, 0.0, 0.0, 0.0, 1.0, 0.0)
        return CameraGeometry(720, 540, "plumb_bob", (0.0,) * 5, k, unturned, p)

    return {"left": of(0.0), "right": of(camera.baseline_m)}


class _TrueCameras:
    """The cameras of a stage, at its present frame."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage

    def take(self, setting: ExposureSetting) -> Made:
        """See `Cameras`."""
        stage = self._stage
        time_s = stage.start_s(stage.frame) + setting.exposure_time_us / 2e6
        return Made(stage.take(setting), stage.frame, 0.0, 1.0, fused=True, time_s=time_s)


# Stops from the middle of the bracket at which emulated frames are compared with true ones.
OFFSETS = tuple(range(-4, 5))
APART = (0, 14, 21)  # Frames before the last at which the light is found: in cycles that share no shot
REPEATS = 12  # Frames of one exposure, whose mean tells the error from the noise


def measure_lap(*, light: Light, room: int, frames: int, policies: list[str]) -> dict[str, Any]:
    """Policies on one lap through a room, rejudged, driven, and driven again with other noise."""
    stage = odometry_stage(light, room, room, 0)
    drive = record(stage, frames, Bracketing())
    reference = ReferenceTrajectory.of(truth(stage, frames / RATE_HZ), drive.timeline.cycle_s)
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


def _compared(stage: Stage, exposer: Exposer, lights: list[SeenLight], level: float) -> dict[str, float]:
    """Mean error of emulated frames, rms of what does not average out, their noise and that of true ones; grey levels.
    `lights` were seen at different times, so that their own noise averages out, too."""
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
