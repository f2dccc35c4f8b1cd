from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.recording.file import RecordingFile, Step
from evaluation.experiments.rejudge import simulated_geometries, simulated_setup
from evaluation.odometry.tracking import odometry_stage
from evaluation.stage.camera import DelayedLoop
from evaluation.stage.rendering import Stage
from imaging.frames import StereoPair

FRAMES = 36
BEGIN_S = 4.0  # in full motion


def moving_stage() -> Stage:
    stage = odometry_stage("even", 1, 1, 0)
    stage._start_times_s = BEGIN_S + np.arange(FRAMES) / 60.0
    return stage


@pytest.fixture(scope="session")
def drive_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording in brackets of the simulated rig in motion, in four shots to a cycle."""
    path = tmp_path_factory.mktemp("rejudge") / "drive.mcap"
    setup = simulated_setup(Bracketing(4, 4.0))
    stage, delayed = moving_stage(), DelayedLoop(ControlLoop(setup), 2)
    file = RecordingFile(path, "rig")
    for number in range(FRAMES):
        stage.go_to(number)
        pair = delayed.step(stage.take)
        copies = {side: replace(frame, pixels=frame.pixels.copy()) for side, frame in pair.frames.items()}
        step = Step(
            number + 1,
            2,
            StepInputs(StereoPair(number, copies)),
            delayed.decisions[-1],
            calibrations=simulated_geometries(),
        )
        file.write(step, setup, delayed.loop.state() if number == 0 else None)
    file.close(FRAMES, 0)
    return path
