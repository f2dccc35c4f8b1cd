"""`autoexpose calibrate vignette` as a user meets it: before a fake camera, and with pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.vignetting.file import VignettingFile
from fake_camera.world.sensor import SensorModel, falloff
from tests.calibration.command_line import done, refused
from tests.calibration.vignetting.flat_field import truth, worst
from tests.fakes import fake_camera, unique


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Of a wall, through the fakes' lens."""
    folder, rng = tmp_path / "pictures", np.random.default_rng(3)
    folder.mkdir()
    for number in range(4):
        picture = 180 * truth(0.6) + rng.normal(0, 1, (270, 360))
        cv2.imwrite(str(folder / f"{number}.png"), np.rint(picture).astype(np.uint8))
    return folder


@pytest.mark.wire
def test_the_lens_of_a_colour_camera_is_measured_over_the_wire(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.vignetting.field.PAUSE_S", 0.0)
    monkeypatch.setattr("calibration.vignetting.field.FRAMES", 2)
    light = tmp_path / "light.yaml"
    light.write_text("light: [{at_s: 0, lux: 300}]")
    serial, path = unique("VIG")[:15], tmp_path / "left.vignetting.yaml"
    options = ["--scene", "wall", "--corner-light", "0.5", "--light", str(light), "--pixel-format", "BayerRG8"]
    with fake_camera(serial, options=options):
        output = done("vignette", "--camera", serial, "-o", str(path))
    assert "response: half the exposure time gives 0.500 of the light" in output
    file = VignettingFile.load(path)
    file.check_belongs(serial, (720, 540))
    assert worst(file.vignetting, falloff(SensorModel(corner_light=0.5))) <= file.error <= 0.01
    assert "Believe it" in path.with_suffix(".html").read_text()


def test_pictures_become_a_file_and_a_report(pictures: Path, tmp_path: Path) -> None:
    path = tmp_path / "v.yaml"
    assert "response: not checked, as it takes two exposure times" in done(
        "vignette", "--images", str(pictures), "-o", str(path)
    )
    file = VignettingFile.load(path)
    assert file.camera is None
    assert worst(file.vignetting, truth(0.6)) <= file.error
    report = path.with_suffix(".html").read_text()
    assert report.count("data:image/png") == 4
    assert "http" not in report.replace("http://www.w3.org", "")


def test_a_refused_set_leaves_a_report_and_no_file(pictures: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(pictures / "5.png"), np.full((270, 360), 255, np.uint8))
    assert "refused: 100.0% of the picture is saturated" in refused(
        "vignette", "--images", str(pictures), "-o", str(tmp_path / "v.yaml")
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pictures", "v.html"]


def test_impossible_input_is_one_sentence(pictures: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(pictures / "small.png"), np.zeros((8, 8), np.uint8))
    (tmp_path / "gain.yaml").write_text("format: autoexpose-gain/1")
    here, rig = str(tmp_path / "v.yaml"), tmp_path / "rig.yaml"
    rig.write_text("cameras: {left: {serial: A, response: missing.yaml}}")
    for arguments, words in (
        (("-o", here), "say what to calibrate: one of --camera, --config and --images"),
        (
            ("--images", str(pictures), "-o", here),
            "small.png: is 8x8 pixels of 8 bits, 0.png is 360x270 pixels of 8 bits",
        ),
        (("--images", str(tmp_path / "none"), "-o", here), "is not a folder"),
        (("--images", str(pictures), "-o", str(tmp_path / "v.html")), "the report needs this name"),
        (("--images", str(pictures), "-o", str(tmp_path / "gain.yaml")), "it is not a vignetting file to replace"),
        (("--camera", "A", "--camera", "B", "--response", "r.yaml", "-o", here), "--response is for one camera"),
        (("-c", str(rig), "-o", here), "missing.yaml"),
    ):
        output = refused("vignette", *arguments)
        assert words in " ".join(output.split())
        assert "Traceback" not in output
