"""A simulated drive, recorded in brackets and really driven by each policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from autoexpose_daemon.control.loop import ControlSetup
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from evaluation.odometry.stereo import StereoCamera
from evaluation.rejudge.camera import Made
from evaluation.rejudge.contest import Round, first_setting, play
from evaluation.rejudge.drive import Drive, watched
from evaluation.rejudge.following import IN_HOUSE, Following
from evaluation.rejudge.rectify import Rectifier
from evaluation.rejudge.run import Figures, Judge, PolicyRun
from evaluation.rejudge.trajectory import Reference, Trajectory
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop
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
    return ControlSetup("fixed", responses, LIMITS, START, parameters, {}, {})


def record(stage: Stage, frames: int, bracketing: Bracketing) -> Drive:
    """Drive once in brackets; the pairs stay in memory."""
    setup = simulated_setup(bracketing)
    delayed = DelayedLoop(setup.loop(), DELAY_FRAMES)
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


def rejudged(drive: Drive, policies: Sequence[str], reference: Reference | None) -> list[Compared]:
    """The policies on the recorded drive."""
    outcomes = play(Round(drive, policies, IN_HOUSE, reference, Path()))
    return [Compared(outcome.figures, outcome.levels) for outcome in outcomes]


def driven(stage: Stage, drive: Drive, policies: Sequence[str], reference: Reference | None) -> list[Compared]:
    """The policies on drives of their own, judged as often as the recorded one."""
    rectifier = Rectifier(drive.geometries, drive.shape)
    cycle = drive.timeline.cycle
    following = Following(IN_HOUSE, rectifier.camera, cycle / RATE_HZ, Path())
    runs = [
        PolicyRun(
            replace(drive.setup.of_policy(policy), start=first_setting(drive)),
            DELAY_FRAMES,
            Judge(rectifier, None if reference is None else following.begin(policy)),
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
