"""Drives of the simulated rig that are recorded in brackets, in virtual time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from autoexpose_daemon.control.loop import ControlSetup
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.recording.file import RecordingFile
from autoexpose_daemon.recording.step import Step
from calibration.geometry.model import CameraGeometry
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import SIDES, Side, StereoPair
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop
from evaluation.stage.rendering import Stage
from fake_camera.world.sensor import SensorModel

START = ExposureSetting(2000.0, 0.0)
SENSOR = SensorModel()


def setup(bracketing: Bracketing | None = None) -> ControlSetup:
    """That of the simulated rig."""
    parameters = ControlParameters(
        full_well_e=SENSOR.full_well_e, read_noise_e=SENSOR.read_noise_e, bracket=bracketing or Bracketing()
    )
    return ControlSetup(
        "fisher-map", dict.fromkeys(SIDES, ResponseFunction.linear()), LIMITS, START, parameters, {}, {}
    )


def geometries() -> dict[Side, CameraGeometry]:
    """Those of the simulated cameras."""
    k = (860.0, 0.0, 359.5, 0.0, 860.0, 269.5, 0.0, 0.0, 1.0)
    unturned = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    def of(baseline_m: float) -> CameraGeometry:
        p = (860.0, 0.0, 359.5, -860.0 * baseline_m, 0.0, 860.0, 269.5, 0.0, 0.0, 0.0, 1.0, 0.0)
        return CameraGeometry(720, 540, "plumb_bob", (0.0,) * 5, k, unturned, p)

    return {"left": of(0.0), "right": of(0.08)}


def record(stage: Stage, frames: int, path: Path, given: ControlSetup | None = None) -> list[StereoPair]:
    """Record the first frames of a course; returns its pairs."""
    given = given or setup()
    delayed = DelayedLoop(given.loop(), 2)
    file = RecordingFile(path, "rig")
    pairs = []
    for number in range(frames):
        stage.go_to(number)
        pair = delayed.step(stage.take)
        copies = {side: replace(frame, pixels=frame.pixels.copy()) for side, frame in pair.frames.items()}
        pairs.append(StereoPair(pair.trigger, copies))
        state = delayed.loop.state() if number % 60 == 0 else None
        step = Step(number + 1, 2, pairs[-1], delayed.decisions[-1], calibrations=geometries())
        file.write(step, given, state)
    file.close(frames, 0)
    return pairs
