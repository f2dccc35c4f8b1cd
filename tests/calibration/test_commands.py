"""`autoexpose calibrate` as a user meets it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from calibration.commands.rig import CameraMode, keys_of
from calibration.document import CameraIdentity
from calibration.response.file import Origin, ResponseFile
from calibration.response.result import Result
from calibration.response.result import calibrate as solved
from calibration.sweep import SweepPlan
from imaging.errors import CameraError
from imaging.exposure import ExposureSetting
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction, prediction_tables
from tests.calibration.command_line import calibrate, done, refused
from tests.calibration.sweeps import MadeUpCamera, sweep, true_response
from tests.fakes import FakeCamera, fake_camera

DELTAS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)


def write_images(folder: Path, camera: MadeUpCamera, times_us: list[float]) -> Path:
    folder.mkdir()
    settings = tuple(ExposureSetting(time_us, 0.0) for time_us in times_us)
    for setting, (shot,) in SweepPlan(settings, 1).run(camera):
        cv2.imwrite(str(folder / f"img_{setting.exposure_time_us:.0f}us.png"), shot.pixels)
    return folder


def test_images_become_a_response_file_and_a_report(tmp_path: Path) -> None:
    images = write_images(tmp_path / "shots", MadeUpCamera(), [100.0 * 2**n for n in range(11)])
    file = tmp_path / "camera.response.yaml"
    output = done("response", "--images", str(images), "-o", str(file))
    assert "verdict: " in output
    assert f"written: {file}, {file.with_suffix('.html')}" in output
    assert "for the configuration" not in output
    loaded = ResponseFile.load(file)
    assert loaded.origin.camera is None
    assert loaded.model == "gamma"
    assert loaded.parameters["gamma"] == pytest.approx(1 / 2.2, rel=0.02)
    assert file.with_suffix(".png").exists()


def test_a_refused_sweep_leaves_a_report_and_no_file(tmp_path: Path) -> None:
    images = write_images(tmp_path / "shots", MadeUpCamera(light=lambda shot: 0.0), [100.0, 400.0, 1600.0, 6400.0])
    file = tmp_path / "camera.response.yaml"
    output = refused("response", "--images", str(images), "-o", str(file))
    assert "refused: all images are black (grey 0)" in output
    assert "verdict: refused" in output
    assert not file.exists()
    assert "Refused" in file.with_suffix(".html").read_text(encoding="utf-8")


def test_the_first_camera_of_a_rig_is_kept_if_the_second_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(mode: CameraMode, gain_db: float, console: Console) -> Result:
        if mode.serial == "B":
            raise CameraError("no camera with serial B")
        origin = Origin(CameraIdentity("Maker", "Model 7", mode.serial))
        return solved(mode.serial, origin, sweep(MadeUpCamera(), [100.0 * 2**n for n in range(11)]))

    monkeypatch.setattr("calibration.commands.app.measure_camera", measured)
    code, output = calibrate("response", "--camera", "A", "--camera", "B", "-o", str(tmp_path))
    assert (code, output) == (1, "autoexpose: no camera with serial B")
    assert ResponseFile.load(tmp_path / "left.response.yaml").model == "gamma"
    assert not (tmp_path / "right.response.yaml").exists()


def test_keys_name_files_as_the_configuration_finds_them() -> None:
    config, file = Path("etc/rig.yaml"), Path("responses/left.response.yaml")
    left, right = (CameraMode(name, name, config=config) for name in ("left", "right"))
    assert keys_of({file: left}, "response") == {file: {"cameras.left.response": Path("..") / file}}
    whole = Path("/responses/right.yaml")
    assert keys_of({whole: right}, "response") == {whole: {"cameras.right.response": whole}}
    assert keys_of({file: CameraMode("22500002")}, "response") == {file: {"cameras.NAME.response": file}}


@pytest.mark.parametrize("name", ["mask.png", "mask.html"])
def test_only_a_former_report_is_replaced(tmp_path: Path, name: str) -> None:
    images = write_images(tmp_path / "shots", MadeUpCamera(), [100.0 * 2**n for n in range(11)])
    foreign, file = tmp_path / name, tmp_path / "mask.yaml"
    foreign.write_text("precious")
    output = refused("response", "--images", str(images), "-o", str(file))
    assert f"{foreign}: is not a former report" in output
    assert foreign.read_text() == "precious"
    foreign.unlink()
    for _ in range(2):
        done("response", "--images", str(images), "-o", str(file))


def test_check_tells_what_a_file_is(tmp_path: Path) -> None:
    file = tmp_path / "r.yaml"
    identity = CameraIdentity("Maker", "Model 7", "0012")
    ResponseFile(ResponseFunction.linear(), Origin(identity, PixelFormat.MONO8), "linear", covered=(4, 250)).save(file)
    output = done("check", str(file))
    assert "Maker Model 7, serial 0012" in output
    assert "grey 4 to 250" in output
    assert "verdict: believe it" in output
    ResponseFile(ResponseFunction.linear()).save(file)
    assert "verdict: none: the file does not say how it was measured" in calibrate("check", str(file))[1]


def test_export_writes_tums_table(tmp_path: Path) -> None:
    file, table = tmp_path / "r.yaml", tmp_path / "pcalib.txt"
    ResponseFile(ResponseFunction.linear()).save(file)
    output = done("export", str(file), "--format", "tum")
    assert len(output.split()) == 256
    assert calibrate("export", str(file), "--format", "tum", "-o", str(table))[0] == 0
    assert table.read_text(encoding="utf-8") == output
    for existing in (table, file):
        content = existing.read_bytes()
        output = refused("export", str(file), "--format", "tum", "-o", str(existing))
        assert f"{existing}: cannot be written (File exists)" in output
        assert existing.read_bytes() == content


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("response -o out.yaml", "one of --camera, --config and --images"),
        ("response --camera A --camera B --camera C -o rig", "--camera is given 3 times"),
        ("response --camera A -o missing/out.yaml", "out.yaml: cannot be written"),
        ("response --camera A -o left.html", "left.html: the report needs this name"),
        ("response --camera A -o nobody.yaml", "not a response file to replace"),
        ("response --images missing -o out.yaml", "missing"),
        ("response -c missing.yaml -o rig", "missing.yaml: cannot be read"),
        ("response -c number.yaml -o rig", "cameras.left.serial is 12: give it in quotes"),
        ("gain -o out.yaml", "one of --camera and --config"),
        ("gain --camera A --camera A -o rig", "left and right are the same camera, A"),
        ("gain --camera A -o missing/out.yaml", "out.yaml: cannot be written"),
        ("gain --camera A -o nobody.yaml", "not a gain file to replace"),
        ("gain --camera NO-SUCH -o out.yaml", "NO-SUCH"),
        ("check other.yaml --camera A", "camera.serial is B, but this is camera A"),
        ("export other.yaml --format tum -o missing/pcalib.txt", "pcalib.txt: cannot be written"),
    ],
)
def test_what_cannot_be_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("number.yaml").write_text("cameras: {left: {serial: 12}}")
    Path("nobody.yaml").write_text("cameras: {}")
    identity = CameraIdentity("Maker", "Model 7", "B")
    ResponseFile(ResponseFunction.linear(), Origin(identity)).save(Path("other.yaml"))
    output = refused(*arguments.split())
    assert words in output
    assert "\n" not in output.strip()


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the exposures, for half the time, and no plots, which take as long again."""
    monkeypatch.setattr("calibration.sweep.STEP_STOPS", 1.0)
    monkeypatch.setattr("calibration.report.plots._png", lambda figure: b"")


@contextlib.contextmanager
def bright_camera(tmp_path: Path, response: str, scene: str = "room", lux: int = 6000) -> Iterator[FakeCamera]:
    """On a tripod under light so bright that all exposures are short, and the sweep is."""
    light = tmp_path / "light.yaml"
    light.write_text(f"light: [{{at_s: 0, lux: {lux}}}]")
    options = ["--still", "--light", str(light), "--response", response, "--scene", scene]
    with fake_camera(options=options) as camera:
        yield camera


def prediction_errors(found: ResponseFunction, low: int, high: int) -> NDArray[np.float64]:
    """By how many grey levels predictions from greys between two are wrong, where the camera's curve is a gamma."""
    tables = prediction_tables(found, DELTAS).astype(float)
    true = prediction_tables(true_response("gamma"), DELTAS).astype(float)
    open_ends = (true > 0) & (true < 255) & (tables > 0) & (tables < 255)
    open_ends[:, :low] = open_ends[:, high + 1 :] = False
    return np.asarray((tables - true)[open_ends])


@pytest.mark.wire
@pytest.mark.usefixtures("quick")
def test_a_camera_is_swept_checked_and_predicted_as_it_really_is(tmp_path: Path) -> None:
    file = tmp_path / "left.response.yaml"
    with bright_camera(tmp_path, "gamma") as camera:
        document = json.loads(done("response", "--camera", camera.serial, "-o", str(file), "--json"))
        assert document["results"][0]["verdict"] == "believe it"
        assert document["written"] == [str(file), str(file.with_suffix(".html"))]
        assert document["configuration"] == {"cameras.NAME.response": str(file)}
        assert "verdict: believe it" in done("check", str(file), "--camera", camera.serial)
    loaded = ResponseFile.load(file)
    assert loaded.origin.camera == CameraIdentity("Autoexpose", "FakeGV287M", camera.serial)
    assert (loaded.origin.pixel_format, loaded.origin.gain_db) == ("Mono8", 0.0)
    assert loaded.covered is not None
    low, high = loaded.covered
    assert low <= 8
    assert high >= 247
    error = prediction_errors(loaded.response, low, high)
    assert np.sqrt(np.mean(error**2)) < 1.0
    assert np.percentile(np.abs(error), 99) <= 2.0


@pytest.mark.wire
@pytest.mark.usefixtures("quick")
def test_a_wall_is_swept_at_two_gains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.sweep.STEP_STOPS", 0.8)  # a wall shows too little in full stops
    file = tmp_path / "left.response.yaml"
    with bright_camera(tmp_path, "gamma", "wall", 1000) as camera:
        output = done("response", "--camera", camera.serial, "-o", str(file))
    assert "the scene has one brightness only: again at 1" in output
    assert ", and as many at 1" in output
    loaded = ResponseFile.load(file)
    assert loaded.origin.gain_db == 0.0
    assert loaded.covered is not None
    error = prediction_errors(loaded.response, *loaded.covered)
    assert np.sqrt(np.mean(error**2)) < 2.0  # 0.1, or more where chance asks for a curve of free shape


@pytest.mark.wire
@pytest.mark.usefixtures("quick")
def test_both_cameras_of_a_rig_are_calibrated_and_compared(tmp_path: Path) -> None:
    config, folder = tmp_path / "rig.yaml", tmp_path / "responses"
    with bright_camera(tmp_path, "gamma") as left, bright_camera(tmp_path, "linear") as right:
        config.write_text(
            f"cameras: {{left: {{serial: {left.serial}}}, right: {{serial: {right.serial}}}}}\n"
            "image: {pixel_format: Mono12, binning: 2}"
        )
        output = done("response", str(config), "-o", str(folder))
    assert "each needs its own file" in output
    for name in ("left", "right"):
        assert f"for the configuration: cameras.{name}.response: {folder / name}.response.yaml" in output
    for name, camera, model in (("left", left, "gamma"), ("right", right, "linear")):
        loaded = ResponseFile.load(folder / f"{name}.response.yaml")
        loaded.check_belongs(camera.serial, "Mono12", 2)
        assert loaded.model == model
        report = (folder / f"{name}.response.html").read_text(encoding="utf-8")
        assert "Left and right predict" in report
