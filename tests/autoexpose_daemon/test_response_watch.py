from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from autoexpose_daemon.config import load_config
from autoexpose_daemon.response_watch import DRIFT_GREY, RigWatch, refined_path
from calibration.response import ResponseFunction
from calibration.response_file import CameraIdentity, Origin, ResponseFile
from drivers.errors import ConfigurationError
from drivers.exposure import ExposureSetting
from drivers.frames import Frame, SettingSource, StereoPair

TRUE = ResponseFunction(np.log2(np.maximum(np.arange(256), 0.5) / 255) / 0.45, 0, 255)
SCENE = np.random.default_rng(1).uniform(-9.0, -1.0, (200, 280))


def watch_of(folder: Path, believed: ResponseFunction, refine: bool = True) -> tuple[RigWatch, Path]:
    file = folder / "left.response.yaml"
    ResponseFile(believed, Origin(CameraIdentity("Maker", "Model 7", "A"), "Mono8"), "gamma").save(file)
    config = folder / "rig.yaml"
    config.write_text(
        f"cameras: {{left: {{serial: A, response: {file.name}}}, right: {{serial: B}}}}\n"
        f"response: {{refine: {str(refine).lower()}}}"
    )
    return RigWatch(load_config(config)), file


def frame(trigger: int, stops: float, source: SettingSource) -> Frame:
    setting = ExposureSetting(1000.0 * 2.0**stops, 0.0)
    grey = np.rint(TRUE.intensity(SCENE + stops)).astype(np.uint8)
    return Frame(grey, 8, trigger, 0, 0, 0, setting, source)


def drive(watch: RigWatch, source: SettingSource = "chunk", every: int = 1) -> None:
    """Exposure jumps up and down by a stop; both cameras see the same through the same response."""
    for count in range(240):
        left, right = (frame(count, count // 3 % 2, source) for _ in range(2))
        watch.observe(StereoPair(every * count, left, right))


def test_a_response_that_does_not_hold_is_told_and_mended_in_a_copy(tmp_path: Path) -> None:
    believed = ResponseFunction(np.log2(np.maximum(np.arange(256), 0.5) / 255) / 0.6, 0, 255)
    watch, file = watch_of(tmp_path, believed)
    before = file.read_bytes()
    drive(watch)
    assert watch.drift_grey["left"] > DRIFT_GREY
    assert watch.drift_grey["right"] > DRIFT_GREY  # it has no file, and is thought to be linear
    watch.save()
    assert file.read_bytes() == before
    refined = ResponseFile.load(refined_path(file))
    assert refined_path(file).name == "left.response.refined.yaml"
    assert refined.origin.camera == CameraIdentity("Maker", "Model 7", "A")
    one_stop = refined.response.log2_exposure[[100, 180]] - TRUE.log2_exposure[[100, 180]]
    assert np.ptp(one_stop) < 0.1
    assert [path.name for path in tmp_path.glob("*refined*")] == ["left.response.refined.yaml"]


def test_one_that_holds_is_not_blamed(tmp_path: Path) -> None:
    watch, _ = watch_of(tmp_path, TRUE)
    drive(watch)
    assert watch.drift_grey["left"] < 1.0


def test_without_refine_no_file_is_written(tmp_path: Path) -> None:
    watch, file = watch_of(tmp_path, ResponseFunction.linear(), refine=False)
    drive(watch)
    watch.save()
    assert not refined_path(file).exists()


@pytest.mark.parametrize(("source", "every"), [("ledger", 1), ("chunk", 2)])
def test_frames_of_uncertain_setting_and_pairs_with_gaps_are_left_out(
    tmp_path: Path, source: SettingSource, every: int
) -> None:
    watch, _ = watch_of(tmp_path, ResponseFunction.linear())
    drive(watch, source, every)
    assert watch.drift_grey == {}


def test_there_must_be_something_to_refine(tmp_path: Path) -> None:
    config = tmp_path / "rig.yaml"
    config.write_text("cameras: {left: {serial: A}}\nresponse: {refine: true}")
    with pytest.raises(ConfigurationError, match="response file to refine"):
        load_config(config)
