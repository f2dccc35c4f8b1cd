"""What a response calibration leaves: its file, the table of TUM's tools, and the report in a browser."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
import subprocess
import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from calibration.document import CameraIdentity, Finding
from calibration.report import write_report
from calibration.report.plots import DASHES, pictures
from calibration.response.file import Origin, ResponseFile, ResponseSolution, tum_table
from calibration.response.result import Result, calibrate
from calibration.response.tones import compare
from imaging.errors import ConfigurationError
from imaging.pixels import PixelFormat
from imaging.python310 import UTC
from imaging.response import ResponseFunction
from tests.calibration.sweeps import MadeUpCamera, gamma, linear, sweep

SOLUTION = ResponseSolution(
    ResponseFunction.linear(4), "gamma", {"gamma": 0.4545}, np.full(256, 0.0125), (6, 250), 0.312, accurate=(20, 240)
)


ORIGIN = Origin(
    CameraIdentity("Maker", "Model 7", "0012"),
    PixelFormat.MONO8,
    binning=2,
    gain_db=3.0,
    date=datetime(2026, 11, 21, 12, 0, tzinfo=UTC),
    tool="autoexpose-daemon 1.0.0",
)


def full() -> ResponseFile:
    finding = Finding("warned", "few_levels", "Grey 40 to 200 alone: sweep a brighter scene.")
    file = ResponseFile.of_solution(SOLUTION, ORIGIN, (finding,))
    return dataclasses.replace(file, noise={"gain": 0.1}, latency={"exposure": 2})


@pytest.mark.parametrize(("covered", "hatched"), [((1, 254), False), ((0, 255), False), ((20, 255), True)])
def test_captions_speak_of_hatching_where_there_is_some(covered: tuple[int, int], hatched: bool) -> None:
    swept = sweep(MadeUpCamera(), [100.0 * 2**n for n in range(11)])
    result = replace(calibrate("it", ORIGIN, swept), solution=replace(SOLUTION, covered=covered))
    told = [picture.caption for picture in pictures(result) if picture.title in ("Response", "Uncertainty")]
    assert ["Hatched" in caption for caption in told] == [hatched, hatched]


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
        ("camera", {"vendor": "Maker", "model": "Model 7", "serial": 12}),
        ("pixel_format", "BayerRG9"),
        ("binning", 0),
        ("binning", 10**9),
        ("gain_db", float("nan")),
        ("date", "yesterday"),
        ("tool", 1),
        ("model", "spline"),
        ("parameters", {"gamma": "x"}),
        ("covered", [250, 6]),
        ("residual_grey", True),
        ("findings", [{"severity": "fatal", "reason": "x", "text": "x"}]),
        ("noise", 3),
        ("uncertainty_stops", [0.1] * 255),
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


SWEPT = Origin(
    CameraIdentity("Maker", "Model 7", "0012"), PixelFormat.MONO8, None, 0.0, datetime(2026, 11, 21, tzinfo=UTC), "ours"
)
TIMES_US = np.geomspace(60, 120_000, 20)
IRREGULAR = {"severity": "warned", "reason": "irregular", "text": "a write takes no fixed number of frames"}
NOISE = {
    "gains": [
        {"gain_db": 0.0, "system_gain": [0.123456, 0.002], "full_well_e": None},
        {"gain_db": 6.0, "findings": [{"severity": "warned", "reason": "light_drift", "text": "the light changed"}]},
    ]
}
LATENCY = {"rate_hz": 60.0, "exposure time": {"mode_frames": 2, "frames": {2: 30}, "findings": [IRREGULAR]}}
COUNT = """<script>addEventListener("load", () => {
  const broken = [...document.images].filter(image => !image.complete || !image.naturalWidth).length;
  document.body.dataset.images = document.images.length + " images, " + broken + " broken";
});</script>"""


def result_of(camera: MadeUpCamera) -> Result:
    return calibrate("camera 0012", SWEPT, sweep(camera, TIMES_US), ("no chunk data: settings are inferred",))


@pytest.fixture(scope="module")
def solved() -> Result:
    return result_of(MadeUpCamera(gamma))


@pytest.fixture(scope="module")
def known(solved: Result) -> Result:
    """The same, of a camera whose noise and latency were measured before."""
    return solved.keeping(replace(solved.file, noise=NOISE, latency=LATENCY))


@pytest.fixture(scope="module")
def page(known: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(tmp_path_factory.mktemp("report") / "left.response.yaml", known)


def browse(page: Path, tmp_path: Path) -> tuple[str, str]:
    """The page's content after it was loaded, with its images counted, and what the browser complained of."""
    counted = tmp_path / "counted.html"
    counted.write_text(page.read_text(encoding="utf-8") + COUNT, encoding="utf-8")
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", counted.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return shown.stdout, "\n".join(line for line in shown.stderr.splitlines() if "CONSOLE" in line)


@pytest.mark.needs("chromium")
def test_the_page_opens_in_a_browser_and_needs_nothing_else(solved: Result, page: Path, tmp_path: Path) -> None:
    assert page.name == "left.response.html"
    content, complaints = browse(page, tmp_path)
    assert complaints == ""
    assert f'data-images="{content.count("<img")} images, 0 broken"' in content
    assert content.count("<img") == 6
    assert all(source.startswith("data:") for source in re.findall(r'(?:src|href)="([^"]*)"', content))
    text = re.sub(r"<style.*?</style>|<[^>]+>", " ", content, flags=re.S)
    for words in ("Believe it", "serial 0012", f"{solved.solution.residual_grey:.2f} grey levels rms", "no chunk data"):
        assert words in text


@pytest.mark.needs("chromium")
def test_the_browser_would_tell_a_broken_page(tmp_path: Path) -> None:
    page = tmp_path / "broken.html"
    page.write_text('<img src="missing.png"><script>nothing()</script>')
    content, complaints = browse(page, tmp_path)
    assert 'data-images="1 images, 1 broken"' in content
    assert "nothing is not defined" in complaints


def test_the_plots_lie_beside_it(page: Path) -> None:
    plots = cv2.imread(str(page.with_suffix(".png")))
    assert plots.shape[1] > 1000
    assert plots.std() > 10


def test_a_refused_sweep_has_a_report_that_says_why(tmp_path: Path) -> None:
    refused = result_of(MadeUpCamera(light=lambda shot: 0.0))
    assert refused.file is None
    text = write_report(tmp_path / "r.yaml", refused).read_text(encoding="utf-8")
    assert "Refused" in text
    assert "black" in text
    assert text.count("<img") == 2


def test_a_sweep_of_one_image_has_a_report(tmp_path: Path) -> None:
    one = calibrate("camera 0012", SWEPT, sweep(MadeUpCamera(gamma), [1000.0], frames=1))
    assert [finding.reason for finding in one.findings] == ["too_few_exposures"]
    assert "where 3 are the least" in write_report(tmp_path / "r.yaml", one).read_text(encoding="utf-8")


def test_noise_and_latency_measured_before_stay(solved: Result, known: Result, page: Path) -> None:
    assert (known.file.noise, known.file.latency) == (NOISE, LATENCY)
    text = page.read_text(encoding="utf-8")
    assert "<th>gain db</th><th>system gain</th><th>full well e</th><th>findings</th>" in text
    assert "<td>0</td><td>0.1235±0.0020</td><td>not seen</td><td></td>" in text
    assert "<td>6</td><td></td><td></td><td>light_drift</td>" in text
    assert "<td>warned</td><td>irregular</td><td>a write takes no fixed number of frames</td>" in text
    assert "<th>exposure time: frames: 2</th><td>30</td>" in text
    other = replace(solved.file, origin=Origin(CameraIdentity("Maker", "Model 7", "0013")), noise={"system_gain": 1.0})
    assert solved.keeping(other).noise == {}


def test_two_cameras_are_compared(solved: Result, tmp_path: Path) -> None:
    right = result_of(MadeUpCamera(linear))
    comparison = compare(solved.solution, right.solution)
    text = write_report(tmp_path / "left.response.yaml", solved, (comparison, solved, right)).read_text(
        encoding="utf-8"
    )
    assert "each needs its own file" in text
    assert text.count("<img") == 7


def test_curves_are_told_apart_without_colour() -> None:
    assert len({(dash, marker) for _, _, dash, marker in DASHES}) == len(DASHES)
