"""Vignetting is recovered from flat fields, sets that cannot show it are refused; and its file."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

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
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.python310 import UTC
from imaging.vignetting import Vignetting
from tests.calibration.vignetting.flat_field import LINEAR, gamma_response, looks, truth, worst

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
            tool="autoexpose-daemon 0.1.0",
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
        ("width: wide", "width is 'wide': give the width of the frames in pixels"),
        ("coefficients: [-2.0]", "coefficients leave less than 2% of the light"),
        ("coefficients: [1.0e+300]", "coefficients has numbers beyond 1000"),
        ("coefficients:\ngrid: [[0.0, 0.0], [0.0, 0.0]]", "grid leave less than 2%"),
        ("coefficients:\ngrid: [[1.0, -1.0], [1.0, -1.0]]", "grid leave less than 2%"),
        ("centre_px: [1.0e+10, 3.0]", "centre_px is [10000000000.0, 3.0]: give column and row near"),
        ("coefficients: [.nan]", "coefficients[0] is nan: give a2, a4"),
        ("coefficients: []", "coefficients is []: give a2, a4"),
        ("grid: [[1.0, 1.0], [1.0, 1.0]]", "give one of coefficients and grid"),
        ("coefficients:\ngrid: [[1.0, 1.0], [1.0]]", "grid must have 2 to 64 rows"),
        ("coefficients:\ngrid: [[1.0, 1.0], [1.0, 0.0]]", "grid leave less than 2%"),
        ("centre_px: [1.0]", "centre_px is [1.0]: give column and row"),
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
