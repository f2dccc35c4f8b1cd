"""Vignetting is recovered from flat fields, or refused; its file, and the command as a user meets it."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.document import CameraIdentity, Finding
from calibration.sweep import Shot
from calibration.vignetting.field import Field, FieldLook, bright_exposure_us, capture_looks, cells, field_of
from calibration.vignetting.file import VignettingFile
from calibration.vignetting.result import calibrate_vignetting
from fake_camera.imaging import ImageSettings
from fake_camera.world.sensor import Sensor, SensorModel, falloff
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.python310 import UTC
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting
from tests.calibration.command_line import done, refused
from tests.fakes import fake_camera, unique

LONG_US = 2000.0
LINEAR = ResponseFunction.linear()


def gamma_response() -> ResponseFunction:
    """Of a sensor with the curve `gamma`."""
    return ResponseFunction(2.2 * np.log2(np.maximum(np.arange(256), 0.5) / 255), 0, 255)


def looks(
    lens: np.ndarray | float,
    response: ResponseFunction = LINEAR,
    *,
    curve: str = "linear",
    tilt: float = 0.0,
    count: int = 8,
    share: float = 0.7,
    changes: float = 0.0,
) -> list[FieldLook]:
    """Looks through a lens: its relative light, or what it leaves in the corners of the fakes.

    `tilt` is how much the light changes across the surface, which is turned from look to look; `share` is how bright
    it is, of the full well; `changes` is by how much the light rises in each look.
    """
    model = SensorModel(width=360, height=270, corner_light=lens if isinstance(lens, float) else 1.0)
    sensor = Sensor(model, 1, curve)
    y, x = np.mgrid[: model.height, : model.width]
    lit = share * model.full_well_e / (model.sensitivity_e_per_lux_s * LONG_US * 1e-6)
    rng, taken = np.random.default_rng(5), []
    for number in range(count):
        angle = rng.uniform(0, 2 * np.pi)
        slope = tilt * (np.cos(angle) * (x / model.width - 0.5) + np.sin(angle) * (y / model.height - 0.5))
        light = lit * (1 + changes * number) * (1 + slope)
        if isinstance(lens, np.ndarray):
            light = light * lens
        fields = []
        for part in (1.0, 0.5):
            settings = ImageSettings(LONG_US * part, 0, 0, 1, "Mono8", 0, 0, model.width, model.height, 1, 1)
            exposure = ExposureSetting(LONG_US * part, 0.0)
            pixels = (sensor.expose(light.astype(np.float32), settings, 100 * number + k) for k in range(4))
            fields.append(field_of([Shot(each, 8, exposure) for each in pixels], response))
        taken.append(FieldLook(*fields, 0.5))
    return taken


def truth(corner_light: float) -> np.ndarray:
    """Of the fakes' lens, shape (270, 360)."""
    return falloff(SensorModel(width=360, height=270, corner_light=corner_light))


def worst(vignetting: Vignetting, lens: np.ndarray) -> float:
    """How far a vignetting is from the truth anywhere, as a share of the light; a common factor is nobody's."""
    ratio = vignetting.relative_light(*lens.shape) / lens
    return float(np.abs(ratio / np.median(ratio) - 1.0).max())


SIZE = (360, 270)


@pytest.mark.parametrize("corner_light", [1.0, 0.8, 0.5, 0.3])
def test_the_fakes_lens_is_recovered_within_the_stated_error(corner_light: float) -> None:
    result = calibrate_vignetting("", SIZE, looks(corner_light))
    assert result.verdict == "believe it"
    assert worst(result.solution.vignetting, truth(corner_light)) <= result.error <= 0.02
    assert result.solution.kind == "polynomial"
    assert result.slope == pytest.approx(1.0, abs=1e-3)


def test_a_curved_response_is_undone_by_its_file_and_told_without_it() -> None:
    known = calibrate_vignetting("", SIZE, looks(0.5, gamma_response(), curve="gamma", share=0.4))
    assert known.verdict == "believe it"
    assert worst(known.solution.vignetting, truth(0.5)) <= known.error <= 0.01
    unknown = calibrate_vignetting("", SIZE, looks(0.5, LINEAR, curve="gamma", share=0.4))
    assert [finding.reason for finding in unknown.findings] == ["wrong_response"]
    assert "half the exposure time gives 0.73" in unknown.findings[0].text


def test_a_lens_off_its_centre_gets_a_centre_and_an_uneven_one_a_grid() -> None:
    y, x = np.mgrid[:270, :360]
    radius2 = ((x - 195) ** 2 + (y - 120) ** 2) / 225**2
    shifted = 1 - 0.4 * radius2 + 0.05 * radius2**2
    result = calibrate_vignetting("", SIZE, looks(shifted))
    assert result.solution.kind == "polynomial about a fitted centre"
    assert result.solution.vignetting.centre_px == pytest.approx((195, 120), abs=1.5)
    assert worst(result.solution.vignetting, shifted) <= result.error
    shaded = truth(0.7) * (1 - 0.1 / (1 + np.exp((x - 330) / 12 + (y - 20) / 25)))
    result = calibrate_vignetting("", SIZE, looks(shaded))
    assert result.solution.kind == "grid"
    assert worst(result.solution.vignetting, shaded) <= result.error


def test_uneven_light_averages_out_over_turns_and_widens_the_error() -> None:
    result = calibrate_vignetting("", SIZE, looks(0.5, tilt=0.1))
    assert result.error > 0.01
    assert worst(result.solution.vignetting, truth(0.5)) <= result.error
    fixed = [looks(0.5, tilt=0.4)[0]] * 8
    assert "uneven_light" in [finding.reason for finding in calibrate_vignetting("", SIZE, fixed).findings]


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        ({"lens": 0.5, "count": 3}, "few_looks"),
        ({"lens": 0.5, "share": 1.1}, "saturated"),
        ({"lens": 0.5, "share": 0.05}, "too_dark"),
        ({"lens": 0.5, "share": 0.3, "changes": 0.1}, "light_changed"),
        ({"lens": 1.0 - 0.2 * (np.indices((270, 360)).sum(axis=0) // 9 % 2)}, "not_flat"),
        ({"lens": 1.0 - 0.2 * (np.indices((270, 360)).sum(axis=0) // 90 % 2)}, "not_flat"),
    ],
)
def test_bad_sets_are_refused_in_a_sentence(made: dict[str, object], reason: str) -> None:
    result = calibrate_vignetting("", SIZE, looks(**made))  # type: ignore[arg-type]
    assert [finding.reason for finding in result.findings] == [reason]
    assert (result.verdict, result.solution) == ("refused", None)


def test_a_picture_that_the_lens_does_not_cover_is_refused() -> None:
    y, x = np.mgrid[:270, :360]
    circle = 1.0 / (1.0 + np.exp((np.hypot(x - 180, y - 135) - 175) / 12))
    result = calibrate_vignetting("", SIZE, looks(circle))
    assert result.verdict == "refused"


def test_cells_cover_pictures_of_any_size() -> None:
    for height, width in ((540, 720), (2048, 2448), (68, 90), (200, 50)):
        rows, columns = cells((height, width))
        assert 2 <= rows <= height / 4
        assert 2 <= columns <= 64


def test_fields_of_deep_pictures_are_those_of_shallow_ones() -> None:
    deep = np.full((70, 100), 2051, np.uint16)
    field = field_of([Shot(deep, 12, ExposureSetting(1.0, 0.0))], LINEAR)
    assert field.level == pytest.approx((2051 - 7.5) / 16 / 255)
    assert (field.clipped, field.texture) == (0.0, 0.0)


class FlatCamera:
    """A camera before an evenly lit surface."""

    limits = ExposureLimits(10.0, 1e6, 0.0, 40.0)

    def __init__(self, lux: float) -> None:
        self._sensor, self._lux, self._taken = Sensor(SensorModel(width=360, height=270, corner_light=0.6), 1), lux, 0

    def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
        settings = ImageSettings(setting.exposure_time_us, setting.gain_db, 0, 1, "Mono8", 0, 0, 360, 270, 1, 1)
        light = np.full((270, 360), self._lux, np.float32)
        self._taken += frames
        return [Shot(self._sensor.expose(light, settings, self._taken + k), 8, setting) for k in range(frames)]


@pytest.mark.parametrize("lux", [2.0, 60.0, 5000.0])
def test_a_camera_finds_its_exposure_and_pauses_between_looks(lux: float) -> None:
    camera, pauses = FlatCamera(lux), list[float]()
    assert 0.5 < camera.take(ExposureSetting(bright_exposure_us(camera, 0.0), 0.0), 1)[0].pixels.max() / 255 < 0.9
    taken = list(capture_looks(camera, LINEAR, pauses.append))
    assert len(pauses) == len(taken) - 1
    result = calibrate_vignetting("", SIZE, taken)
    assert result.verdict == "believe it"


def test_a_black_picture_is_dark_and_not_an_error() -> None:
    black = Field(np.zeros((48, 64)), 0.0, 0.0, 0.0, 0.0)
    result = calibrate_vignetting("", SIZE, [FieldLook(black, black, 0.5)] * 4)
    assert [finding.reason for finding in result.findings] == ["too_dark"]
    assert result.slope is None


POLYNOMIAL = Vignetting(720, 540, (350.0, 271.5), (-0.5, 0.1))
FULL = POLYNOMIAL.relative_light(540, 720)
GRID = Vignetting(4, 4, (1.5, 1.5), (), ((0.5, 0.75), (0.8, 1.0)))


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "left.vignetting.yaml"
    for vignetting in (POLYNOMIAL, GRID):
        file = VignettingFile(
            vignetting,
            0.004,
            camera=CameraIdentity("Autoexpose", "Fake", "0123"),
            date=datetime(2026, 11, 23, tzinfo=UTC),
            tool="autoexpose-daemon 1.0.0",
            findings=(Finding("warned", "uneven_light", "it is"),),
        )
        file.save(path)
        loaded = VignettingFile.load(path)
        assert (loaded.vignetting, loaded.camera, loaded.error) == (file.vignetting, file.camera, file.error)
        assert (loaded.date, loaded.tool, loaded.findings) == (file.date, file.tool, file.findings)


def test_relative_light_is_that_of_the_polynomial_and_of_the_nodes() -> None:
    light = POLYNOMIAL.relative_light(540, 720)
    radius2 = ((10 - 350) ** 2 + (20 - 271.5) ** 2) / 450**2
    assert light[20, 10] == pytest.approx(1 - 0.5 * radius2 + 0.1 * radius2**2, rel=1e-5)
    assert light.max() == 1.0
    nodes = GRID.relative_light(4, 4)
    assert nodes[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx([0.5, 0.75, 0.8, 1.0])
    assert nodes[0, 1] == pytest.approx(0.5 + 0.25 / 3)


@given(rows=st.integers(2, 40), columns=st.integers(2, 40))
def test_any_number_of_parts_shows_the_same_lens(rows: int, columns: int) -> None:
    parts = POLYNOMIAL.relative_light(rows, columns)
    y, x = ((np.arange(rows) + 0.5) * 540 / rows).astype(int), ((np.arange(columns) + 0.5) * 720 / columns).astype(int)
    expected = FULL[np.ix_(y, x)]
    assert parts == pytest.approx(expected / expected.max(), abs=0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("format: autoexpose-gain/1", "only 'autoexpose-vignetting/1' can be read"),
        ("width: 0", "width is 0: give the size of the frames"),
        ("coefficients: [-2.0]", "coefficients leave less than 2% of the light"),
        ("coefficients: [1.0e+300]", "coefficients has numbers beyond 1000"),
        ("coefficients:\ngrid: [[1.0, -1.0], [1.0, -1.0]]", "grid leave less than 2%"),
        ("centre_px: [1.0e+10, 3.0]", "centre_px is [10000000000.0, 3.0]: give column and row near"),
        ("coefficients: [.nan]", "coefficients[0] is nan: give a2, a4"),
        ("grid: [[1.0, 1.0], [1.0, 1.0]]", "give one of coefficients and grid"),
        ("coefficients:\ngrid: [[1.0, 1.0], [1.0]]", "grid must have 2 to 64 rows"),
        ("lens: good", "unknown key 'lens': remove it"),
    ],
)
def test_a_bad_file_is_refused_in_a_sentence(tmp_path: Path, change: str, words: str) -> None:
    path, lines = tmp_path / "v.yaml", {}
    base = "format: autoexpose-vignetting/1\nwidth: 720\nheight: 540\ncoefficients: [-0.5]"
    for line in (*base.splitlines(), *change.splitlines()):
        lines[line.partition(":")[0]] = line
    path.write_text("\n".join(lines.values()))
    with pytest.raises(ConfigurationError) as error:
        VignettingFile.load(path)
    assert words in str(error.value)
    assert str(path) in str(error.value)


def test_files_of_other_cameras_and_sizes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "v.yaml"
    VignettingFile(POLYNOMIAL, camera=CameraIdentity("A", "B", "L1")).save(path)
    file = VignettingFile.load(path)
    file.check_belongs("L1", (720, 540))
    with pytest.raises(ConfigurationError, match=r"camera\.serial is L1, but this is camera L2"):
        file.check_belongs("L2")
    with pytest.raises(ConfigurationError, match="is for frames of 720x540 pixels, but camera L1 sends 640x480"):
        file.check_belongs("L1", (640, 480))


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
