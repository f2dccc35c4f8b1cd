"""What the loop in use says of itself."""

from __future__ import annotations

from typing import cast

import pytest

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.runtime.setup import ActiveLoop
from drivers.camera import CameraDescription
from drivers.rig.events import CameraReady
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from tests.autoexpose_daemon.virtual import SteadyLoop, tuning


class LoopUnderLamps(SteadyLoop):
    """Finds, step by step, what it was told."""

    def __init__(self, *found_hz: float | None) -> None:
        super().__init__(ExposureLimits(20.0, 7500.0, 0.0, 30.0), ExposureSetting(2000.0, 0.0))
        self._found_hz = list(found_hz)

    def step(self, inputs: StepInputs | StereoPair) -> Decision:
        self.flicker_hz = self._found_hz.pop(0)
        return super().step(inputs)


def test_the_log_says_once_that_the_light_flickers_or_no_longer_does(caplog: pytest.LogCaptureFixture) -> None:
    active, pair = ActiveLoop(tuning(2000.0)), StereoPair(0, {})
    active.loop = cast(ControlLoop, LoopUnderLamps(None, 100.0, 100.0, None))
    with caplog.at_level("INFO"):
        for _ in range(4):
            active.step(StepInputs(pair))
    assert caplog.messages == [
        "the light flickers at 100 Hz: exposure times of whole periods, where they fit",
        "the light no longer flickers: any exposure time",
    ]


@pytest.mark.parametrize(("range_stops", "told"), [(6.0, True), (3.0, False)])
def test_brackets_that_do_not_fit_into_the_limits_are_told(
    range_stops: float, told: bool, caplog: pytest.LogCaptureFixture
) -> None:
    sections = {"start": {"exposure_time_us": 2000}, "bracket": {"exposures": 3, "range_stops": range_stops}}
    active = ActiveLoop(tuning(2000.0, control=sections))
    camera = CameraDescription("Maker", "Model 7", "A")
    active.ready(CameraReady("left", camera, ExposureLimits(1000.0, 2000.0, 0.0, 12.0)))
    warned = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warned == told * [
        "brackets of 6.0 stops do not fit into the 3.0 stops of these limits, and their outer shots are clipped: widen "
        "`exposure`, or narrow the brackets"
    ]
