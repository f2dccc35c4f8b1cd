"""How often response files are read: once per reading of the configuration, never again later."""

from __future__ import annotations

from pathlib import Path

import pytest

from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.runtime import setup as cameras
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.rig_control import RigControl
from autoexpose_daemon.runtime.setup import Tuning, openers
from calibration import document
from calibration.response.file import ResponseFile
from drivers.rig import Rig
from drivers.rig.events import CameraGone, CameraReady
from imaging.errors import CameraLostError
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.scripted import TriggeredCamera


@pytest.fixture
def config_file(tmp_path: Path) -> Path:
    for side in ("left", "right"):
        ResponseFile(ResponseFunction.linear()).save(tmp_path / f"{side}.yaml")
    file = tmp_path / "rig.yaml"
    file.write_text("cameras: {left: {serial: L, response: left.yaml}, right: {serial: R, response: right.yaml}}")
    return file


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Records the response files that are read."""
    read: list[str] = []
    load = document.load_mapping

    def counted(path: Path, hint: str) -> object:
        read.append(path.name)
        return load(path, hint)

    monkeypatch.setattr(document, "load_mapping", counted)
    monkeypatch.setattr(cameras, "open_camera", lambda serial, _: TriggeredCamera(serial))
    return read


def test_a_start_reads_each_once(config_file: Path, reads: list[str]) -> None:
    config = load_config(config_file)
    Daemon(config, openers(config))
    assert reads == ["left.yaml", "right.yaml"]


def test_cameras_that_come_back_and_reloads_read_nothing_on_the_control_thread(
    config_file: Path, reads: list[str]
) -> None:
    config = load_config(config_file)
    opened = openers(config)
    control = RigControl(config, Rig(opened, 1.0, config.start))
    reads.clear()
    for _ in range(2):
        for side, open_camera in opened.items():
            camera = open_camera()
            control.take([CameraReady(side, camera.description, camera.limits)])
            control.take([CameraGone(side, CameraLostError("unplugged"), final=False)])
    assert reads == []
    tuning = Tuning(load_config(config_file))
    assert reads == ["left.yaml", "right.yaml"]
    control.tune(tuning)
    assert reads == ["left.yaml", "right.yaml"]
