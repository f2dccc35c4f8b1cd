"""A camera's features and report by the command line: shown, saved, compared, and checked on the wire."""

from __future__ import annotations

import json
import os
import signal
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import yaml

from autoexpose_daemon.doctor import camera_report
from autoexpose_daemon.doctor.camera_report import write_report
from autoexpose_daemon.doctor.facts import Need, gather
from drivers.aravis import FoundCamera
from drivers.genicam.features import differing
from drivers.genicam.nodes import NodeMap
from drivers.setup import CameraSetup, FeatureSetting
from imaging.errors import CameraError, ConfigurationError
from tests.autoexpose_daemon.service.service_process import Within, autoexpose
from tests.fakes import FakeCamera, fake_camera

pytestmark = pytest.mark.wire

FEATURES = "[Width: 320, OffsetX: 400, ReverseX: true, 'LineSelector[Line3].LineInverter': true]"


@pytest.fixture(scope="module")
def camera() -> Iterator[FakeCamera]:
    with fake_camera() as running:
        yield running


@pytest.fixture
def ctrl_c_ends() -> Iterator[None]:
    """As in a new process, whatever handlers other tests have left in this one."""
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, former)


def rig(folder: Path, camera: FakeCamera, features: str) -> Path:
    file = folder / "rig.yaml"
    file.write_text(f"cameras: {{left: {{serial: {camera.serial}, features: {features}}}}}")
    return file


def test_what_is_saved_can_be_used_and_compared(within: Within, tmp_path: Path, camera: FakeCamera) -> None:
    file = rig(tmp_path, camera, FEATURES)
    code, output, _ = within("config", "check", "--camera", str(file))
    assert code == 0, output

    saved, changed = tmp_path / "saved.yaml", tmp_path / "changed.yaml"
    assert within("features", camera.serial, "--save", str(saved))[0] == 0
    code, _, left_out = within("features", camera.serial, "--changed", "--save", str(changed))
    assert code == 0
    assert "driven by the daemon, so left out: " in left_out
    assert yaml.safe_load(changed.read_text()) == yaml.safe_load(file.read_text())
    code, output, _ = within("features", camera.serial, "--diff", str(saved))
    assert (code, output.count("\n")) == (0, 1), output

    assert within("config", "check", "--camera", str(rig(tmp_path, camera, "[OffsetX: 0, Width: 720]")))[0] == 0
    code, output, _ = within("features", camera.serial, "--diff", str(saved))
    assert code == 1
    assert output == f"Width is 720, in {saved} 320\nOffsetX is 0, in {saved} 400\n"
    assert within("config", "check", "--camera", str(saved))[0] == 0
    assert within("features", camera.serial, "--diff", str(saved))[0] == 0

    assert "cannot be written (File exists): name a new" in within.refused(
        "features", camera.serial, "--save", str(saved)
    )


@pytest.mark.usefixtures("ctrl_c_ends")
def test_ctrl_c_while_the_default_user_set_is_loaded_waits_until_the_camera_is_as_before(
    within: Within, tmp_path: Path, camera: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = rig(tmp_path, camera, FEATURES)
    assert within("config", "check", "--camera", str(file))[0] == 0
    compared = []

    def interrupted(nodes: NodeMap, settings: Sequence[FeatureSetting]) -> Iterator[tuple[FeatureSetting, object]]:
        if not compared:
            signal.raise_signal(signal.SIGINT)
        compared.append(settings)
        return differing(nodes, settings)

    monkeypatch.setattr("drivers.genicam.features.differing", interrupted)
    code, output, _ = within("features", camera.serial, "--changed")
    assert (code, output) == (128 + signal.SIGINT, "")
    assert compared
    assert within("features", camera.serial, "--diff", str(file))[0] == 0


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (
            "exposure: {min_gain_db: 60, max_gain_db: 100}",
            "exposure: gain limits 60 to 47 dB leave no gain to choose; the left camera takes",
        ),
        ("control: {roi: {left: {rectangles: [{box: [5000, 5000, 10, 10]}]}}}", "frames are 720x540"),
    ],
)
def test_what_leaves_nothing_of_what_the_camera_does_is_refused_beforehand(
    within: Within, tmp_path: Path, camera: FakeCamera, section: str, words: str
) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(f"cameras: {{left: {{serial: {camera.serial}, features: [OffsetX: 0, Width: 720]}}}}\n{section}")
    assert within("config", "check", str(file))[0] == 0
    assert words in within.refused("config", "check", "--camera", str(file))


def test_what_the_camera_does_not_take_is_refused_beforehand(
    within: Within, tmp_path: Path, camera: FakeCamera
) -> None:
    file = rig(tmp_path, camera, "[Widht: 320, Height: 5000]")
    assert within("config", "check", str(file))[0] == 0
    words = f"camera {camera.serial}: features: Widht: the camera has no such feature; did you mean Width?; Height: it"
    assert words in within.refused("config", "check", "--camera", str(file))
    started = autoexpose("run", "-c", str(file))
    assert started.returncode == os.EX_CONFIG
    assert words in started.stderr.splitlines()[-1]

    code, output, _ = within("doctor", "--json", "-c", str(file))
    (stop,) = (finding for finding in json.loads(output)["findings"] if finding["check"] == "features")
    assert code == 1
    assert stop["severity"] == "stops"
    assert words in stop["sentence"]
    code, output, _ = within("doctor", "--json", "-c", str(rig(tmp_path, camera, "[Height: 540]")))
    assert f"left camera {camera.serial} takes all 1 features" in output
    assert code == 0


@pytest.mark.wire
def test_it_holds_the_description_and_figures_and_nothing_private(tmp_path: Path) -> None:
    path = tmp_path / "camera.zip"
    said: list[str] = []
    with fake_camera(options=["--still"]) as camera:
        need = Need({"left": camera.serial})
        write_report(path, gather(), need, said.append, watched_s=1.0)
        with pytest.raises(ConfigurationError, match=r"camera\.zip: it exists: name a new file"):
            write_report(path, gather(), need, said.append, watched_s=1.0)
        private = [camera.serial, camera.address]
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name).decode() for name in archive.namelist()}
    assert sorted(files) == ["camera1/camera.json", "camera1/description.xml", "host.json"]
    about = json.loads(files["camera1/camera.json"])
    assert (about["vendor"], about["pixel_format"], about["setting_source"]) == ("Autoexpose", "Mono8", "chunk")
    assert about["frames"] + about["incomplete"] + about["missing_ids"] > 15
    assert about["write_ms"]["p50"] > 0 and about["between_starts_ms"]["p50"] == pytest.approx(1e3 / 30, rel=0.01)
    assert "ExposureTime" in files["camera1/description.xml"]
    assert not any(word in text for word in private for text in [*files.values(), *said[:-1]])
    assert said[-1].endswith("1 camera; no images, addresses or serial numbers")


def test_what_went_wrong_is_told_without_address_and_serial(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(serial: str, _setup: CameraSetup) -> None:
        raise CameraError(f"camera {serial}: Can't connect to device at address '10.0.0.2' from 10.0.0.1:3956 (USB3)")

    monkeypatch.setattr(camera_report, "open_camera", refuse)
    found = FoundCamera("10", "Maker", "Model 7", "gige", "10.0.0.2", "Maker-10")
    about, description = camera_report._examined(found, 1.0)
    assert about["not_opened"] == "camera S: Can't connect to device at address 'A' from A:3956 (USB3)"
    assert description == ""


@pytest.mark.parametrize(
    ("incomplete", "words"), [(0, "no frames arrived"), (600, "no whole frame arrived, 600 incomplete ones did")]
)
def test_frames_with_holes_have_arrived(incomplete: int, words: str) -> None:
    assert camera_report._in_words({"frames": 0, "incomplete": incomplete}).strip() == words
