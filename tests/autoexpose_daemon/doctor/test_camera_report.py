"""The report of a camera that a volunteer sends."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

from autoexpose_daemon.doctor import camera_report
from autoexpose_daemon.doctor.camera_report import write_report
from autoexpose_daemon.doctor.facts import Need, gather
from drivers.aravis import FoundCamera
from drivers.setup import CameraSetup
from imaging.errors import CameraError, ConfigurationError
from tests.fakes import fake_camera


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
