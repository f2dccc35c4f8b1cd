"""How soon a write shows, over the wire."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibration.document import CameraIdentity
from calibration.response.file import Origin, ResponseFile
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from tests.calibration.command_line import calibrate
from tests.fakes import fake_camera


@pytest.mark.quiet(
    "A write and its read-back take 0.6 ms, 4 ms once in a hundred, and more beside other work: too late."
)
def test_a_write_shows_in_the_next_exposure(tmp_path: Path) -> None:
    light, file = tmp_path / "light.yaml", tmp_path / "left.response.yaml"
    light.write_text("light: [{at_s: 0, lux: 60}]")
    with fake_camera(options=["--still", "--light", str(light)]) as camera:
        identity = CameraIdentity("Autoexpose", "FakeGV287M", camera.serial)
        ResponseFile(ResponseFunction.linear(0), Origin(identity, PixelFormat.MONO8)).save(file)
        code, output = calibrate("latency", "--camera", camera.serial, "-o", str(file))
    assert code == 0, output
    latency = ResponseFile.load(file).latency
    assert [latency[quantity]["mode_frames"] for quantity in ("exposure", "gain")] == [1, 1]
