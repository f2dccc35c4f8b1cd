"""Response files: read once per configuration, watched while the daemon runs, and refined in a copy."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.runtime import setup as cameras
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.response_drift import REFINE_EVERY, ResponseDrift, refined_paths
from autoexpose_daemon.runtime.rig_control import RigControl
from autoexpose_daemon.runtime.setup import Tuning, openers
from calibration import document
from calibration.document import CameraIdentity
from calibration.response.file import Origin, ResponseFile
from drivers.rig import Rig
from drivers.rig.events import CameraGone, CameraReady
from imaging.errors import CameraLostError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet, SettingSource
from imaging.geometry import SIDES
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.scripted import TriggeredCamera
from tests.calibration.sweeps import true_response


@pytest.fixture
def config_file(tmp_path: Path) -> Path:
    for camera in ("left", "right"):
        ResponseFile(ResponseFunction.linear()).save(tmp_path / f"{camera}.yaml")
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
    control = RigControl(config, Rig(opened, 1.0, dict.fromkeys(opened, config.start)))
    reads.clear()
    for _ in range(2):
        for name, open_camera in opened.items():
            camera = open_camera()
            control.take([CameraReady(name, camera.description, camera.limits)])
            control.take([CameraGone(name, CameraLostError("unplugged"), final=False)])
    assert reads == []
    tuning = Tuning(load_config(config_file))
    assert reads == ["left.yaml", "right.yaml"]
    control.tune(tuning)
    assert reads == ["left.yaml", "right.yaml"]


LEFT = Origin(CameraIdentity("Maker", "Model", "L"), PixelFormat.MONO8)


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Config:
    """Left with the file of a linear response, to be refined; right without a file, hence linear."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    file = tmp_path / "left.response.yaml"
    ResponseFile(true_response("linear"), LEFT).save(file)
    cameras = {"left": {"serial": "L", "response": file}, "right": {"serial": "R"}}
    return Config.model_validate({"cameras": cameras, "response": {"refine": True}})


def show(
    drift: ResponseDrift, left: ResponseFunction, changes: int, source: SettingSource = "chunk", stride: int = 1
) -> None:
    """Frames of a still scene at changing exposures: the left camera has this response, the right one is linear."""
    numbers = np.random.default_rng(5)
    scene_stops = numbers.uniform(-6.0, -1.0, (200, 200))
    right = true_response("linear")
    for index in range(2 * changes):
        if index % 2 == 0:
            setting = ExposureSetting(float(1000.0 * 2.0 ** numbers.uniform(-1.5, 1.0)), 0.0)
        frames = []
        for response in (left, right):
            exact = response.intensity(scene_stops + setting.level - np.log2(1000.0))
            pixels = np.rint(exact + numbers.normal(0.0, 0.7, exact.shape)).clip(0, 255).astype(np.uint8)
            frames.append(Frame(pixels, 8, index, index, index, index, setting, source))
        drift.see(FrameSet(index * stride, dict(zip(SIDES, frames, strict=False))))


def finish_refining() -> None:
    for thread in threading.enumerate():
        if thread.name.startswith("refine-"):
            thread.join()


def test_cameras_whose_responses_hold_are_left_alone(config: Config, tmp_path: Path) -> None:
    drift = ResponseDrift(config)
    show(drift, true_response("linear"), 2 * REFINE_EVERY)
    finish_refining()
    assert drift.misfits == {}
    assert set(drift.residual_grey) == {"left", "right"}
    assert max(drift.residual_grey.values()) < 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["left.response.yaml"]


def test_a_response_that_drifted_is_reported_and_refined_in_a_copy(
    config: Config, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    before = (tmp_path / "left.response.yaml").read_bytes()
    drift = ResponseDrift(config)
    show(drift, true_response("gamma"), 2 * REFINE_EVERY)
    finish_refining()
    assert set(drift.misfits) == {"left"}
    assert "autoexpose calibrate response --camera L" in drift.misfits["left"]
    assert caplog.text.count("left camera: response off by") == 1
    assert (tmp_path / "left.response.yaml").read_bytes() == before
    refined = ResponseFile.load(tmp_path / "left.response.refined.yaml")
    refined.check_belongs("L", "Mono8")
    stops = refined.response.log2_exposure[[32, 64, 128]] - true_response("gamma").log2_exposure[[32, 64, 128]]
    assert np.ptp(stops) < 0.15


def test_files_of_one_name_have_copies_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    files: dict[CameraName, Path] = {camera: Path("/etc/rig", camera, "response.yaml") for camera in SIDES}
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert refined_paths(files)["left"] == Path("/etc/rig/left/response.refined.yaml")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/rig")
    assert refined_paths(files) == {
        "left": Path("/var/lib/rig/left.response.refined.yaml"),
        "right": Path("/var/lib/rig/right.response.refined.yaml"),
    }


def test_a_copy_that_cannot_be_written_is_logged(
    config: Config, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/proc/none")
    drift = ResponseDrift(config)
    show(drift, true_response("gamma"), 2 * REFINE_EVERY)
    finish_refining()
    assert "the refined response could not be written" in caplog.text


def test_pairs_without_a_frame_are_skipped(config: Config) -> None:
    drift = ResponseDrift(config)
    frame = Frame(np.zeros((8, 8), np.uint8), 8, 0, 0, 0, 0, ExposureSetting(1000.0, 0.0))
    drift.see(FrameSet(0, {"left": frame}))
    assert drift.residual_grey == {}


def test_inferred_settings_and_gaps_give_no_verdict(config: Config) -> None:
    for source, stride in (("ledger", 1), ("chunk", 2)):
        drift = ResponseDrift(config)
        show(drift, true_response("gamma"), REFINE_EVERY, source, stride)
        assert drift.residual_grey == {}
