"""Response files: what is saved is loaded, what is wrong is said with its key; and the table of TUM's tools."""

from __future__ import annotations

import dataclasses
import errno
import os
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.document import CameraIdentity, Finding
from calibration.response.file import Origin, ResponseFile, ResponseSolution, tum_table
from imaging.errors import ConfigurationError
from imaging.pixels import PixelFormat
from imaging.python310 import UTC
from imaging.response import ResponseFunction

SOLUTION = ResponseSolution(
    ResponseFunction.linear(4), "gamma", {"gamma": 0.4545}, np.full(256, 0.0125), (6, 250), 0.312, accurate=(20, 240)
)


ORIGIN = Origin(
    CameraIdentity("Maker", "Model 7", "0012"),
    PixelFormat.MONO8,
    binning=2,
    gain_db=3.0,
    date=datetime(2026, 11, 21, 12, 0, tzinfo=UTC),
    tool="autoexpose-daemon 0.1.0",
)


def full() -> ResponseFile:
    finding = Finding("warned", "few_levels", "Grey 40 to 200 alone: sweep a brighter scene.")
    file = ResponseFile.of_solution(SOLUTION, ORIGIN, (finding,))
    return dataclasses.replace(file, noise={"gain": 0.1}, latency={"exposure": 2})


def saved(folder: Path) -> tuple[Path, dict[str, object]]:
    path = folder / "r.yaml"
    full().save(path)
    return path, yaml.safe_load(path.read_text(encoding="utf-8"))


def test_a_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    path, document = saved(tmp_path)
    loaded = ResponseFile.load(path)
    for field in dataclasses.fields(ResponseFile):
        if field.name not in ("response", "path"):
            assert getattr(loaded, field.name) == getattr(full(), field.name), field.name
    assert loaded.response.log2_exposure == pytest.approx(SOLUTION.response.log2_exposure, abs=1e-6)
    assert list(document)[-2:] == ["log2_exposure", "uncertainty_stops"]
    assert len(path.read_text(encoding="utf-8").splitlines()) < 90


def test_a_curve_made_by_hand_is_as_good(tmp_path: Path) -> None:
    path = tmp_path / "hand.yaml"
    ResponseFile(ResponseFunction.linear()).save(path)
    loaded = ResponseFile.load(path)
    assert loaded.origin == Origin()
    loaded.check_belongs("any camera", "Mono16", 4)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("camera", "0012"),
        ("camera", {"vendor": "Maker", "model": "Model 7"}),
        ("camera", {"vendor": "Maker", "model": "Model 7", "serial": 12}),
        ("pixel_format", "BayerRG9"),
        ("pixel_format", ["Mono8"]),
        ("binning", 0),
        ("binning", "2"),
        ("binning", 10**9),
        ("gain_db", float("nan")),
        ("gain_db", 1e308),
        ("date", "yesterday"),
        ("tool", 1),
        ("model", "spline"),
        ("parameters", {"gamma": "x"}),
        ("parameters", {1: 2.0}),
        ("covered", [250, 6]),
        ("covered", [0, 256]),
        ("accurate", [250, 6]),
        ("residual_grey", True),
        ("residual_grey", 1e300),
        ("findings", [{"severity": "fatal", "reason": "x", "text": "x"}]),
        ("noise", 3),
        ("latency", []),
        ("uncertainty_stops", [0.1] * 255),
        ("uncertainty_stops", [-0.1] * 256),
        ("uncertainty_stops", [1e308] * 256),
    ],
)
def test_a_bad_value_is_refused_with_file_and_key(tmp_path: Path, key: str, value: object) -> None:
    path, document = saved(tmp_path)
    path.write_text(yaml.safe_dump(document | {key: value}), encoding="utf-8")
    with pytest.raises(ConfigurationError) as error:
        ResponseFile.load(path)
    assert str(error.value).startswith((f"{path}: {key} is ", f"{path}: {key}["))
    assert str(error.value).endswith(", or remove it")
    assert len(str(error.value)) < len(str(path)) + 200  # 256 numbers are not quoted


@pytest.mark.parametrize(
    ("present", "key"),
    [
        (("0013", "Mono8", 2), "camera.serial is 0012, but this is camera 0013"),
        (("0012", "Mono12", 2), "pixel_format is Mono8, but camera 0012 runs with Mono12"),
        (("0012", "Mono8", 1), "binning is 2, but camera 0012 runs with 1"),
    ],
)
def test_a_file_of_another_camera_or_mode_is_refused(tmp_path: Path, present: tuple[str, str, int], key: str) -> None:
    path, _ = saved(tmp_path)
    file = ResponseFile.load(path)
    with pytest.raises(ConfigurationError) as error:
        file.check_belongs(*present)
    assert str(error.value).startswith(f"{path}: {key}: ")
    assert f"calibrate response --camera {present[0]}" in str(error.value)
    file.check_belongs("0012", "Mono8", 2)
    file.check_belongs("0012")


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be written"):
        full().save(tmp_path / "nowhere" / "r.yaml")


def test_a_full_disk_leaves_the_file_that_was_to_be_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path, _ = saved(tmp_path)
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(ConfigurationError, match="No space left on device"):
        ResponseFile(ResponseFunction.linear()).save(path)
    assert ResponseFile.load(path).model == SOLUTION.model
    assert list(tmp_path.iterdir()) == [path]


GAMMA = ResponseFunction(2.2 * np.log2(np.maximum(np.arange(256), 0.5) / 255), 0, 255)


@pytest.mark.parametrize(
    "response",
    [
        ResponseFunction.linear(),
        ResponseFunction.linear(16),
        GAMMA,
        ResponseFunction(GAMMA.log2_exposure, 30, 200),
        ResponseFunction(GAMMA.log2_exposure + 2000.0, 0, 255),
        ResponseFunction(np.arange(256) * 1e4, 0, 255),
    ],
)
def test_256_numbers_rise_strictly_from_0_to_255_also_in_single_precision(response: ResponseFunction) -> None:
    line = tum_table(response)
    assert line.endswith("\n")
    assert line.count("\n") == 1
    table = np.array(line.split(), np.float32)
    assert table.shape == (256,)
    assert (np.diff(table) > 0).all()
    assert (table[0], table[-1]) == (0.0, 255.0)


def test_the_table_is_the_light_of_each_grey_level() -> None:
    table = np.array(tum_table(GAMMA).split(), float)
    assert table[1:] == pytest.approx(255 * (np.arange(1, 256) / 255) ** 2.2, abs=0.01)
    assert np.array(tum_table(ResponseFunction.linear()).split(), float) == pytest.approx(np.arange(256), abs=0.6)


def test_a_daemon_without_the_extra_reads_calibration_files() -> None:
    """A robot need not have what reports and EXIF take."""
    block = "import sys; sys.modules |= dict.fromkeys(('PIL', 'matplotlib', 'jinja2'))"
    subprocess.run([sys.executable, "-c", f"{block}; import autoexpose_daemon.config.document"], check=True)
