"""Vignetting files: what was written is read back, and what is wrong with one is said in a sentence."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.document import CameraIdentity, Finding
from calibration.vignetting.file import VignettingFile
from imaging.errors import ConfigurationError
from imaging.python310 import UTC
from imaging.vignetting import Vignetting

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
