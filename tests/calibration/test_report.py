"""The report as a reader meets it: in a browser, without a network."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.document import CameraIdentity
from calibration.report import write_report
from calibration.report.plots import DASHES
from calibration.response.file import Origin
from calibration.response.result import Result, calibrate
from calibration.response.tones import compare
from imaging.pixels import PixelFormat
from imaging.python310 import UTC
from tests.calibration.made_up_camera import MadeUpCamera, gamma, linear, sweep

ORIGIN = Origin(
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
    return calibrate("camera 0012", ORIGIN, sweep(camera, TIMES_US), ("no chunk data: settings are inferred",))


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
    one = calibrate("camera 0012", ORIGIN, sweep(MadeUpCamera(gamma), [1000.0], frames=1))
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
