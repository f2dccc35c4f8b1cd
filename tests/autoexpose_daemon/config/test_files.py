"""Files that a configuration names: read once, and refused by key and file."""

from __future__ import annotations

import builtins
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.control.picture.image import Rectangle
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.service import add_outlets
from calibration.document import CameraIdentity
from calibration.gain import GainFile
from calibration.response.file import Origin, ResponseFile
from calibration.vignetting.file import VignettingFile
from drivers.camera import CameraDescription
from imaging.errors import ConfigurationError
from imaging.gain_scale import GainScale
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting
from tests.autoexpose_daemon.config.test_config import LEFT, complaint, load
from tests.calibration.geometry.written import camchain, ros


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    for camera in ("left", "right"):
        (tmp_path / f"{camera}.yaml").write_text(yaml.safe_dump(ros(camera)))
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(camchain()))
    return tmp_path / "rig.yaml"


def write(rig: Path, **files: str) -> Path:
    serials = {"left": "A", "right": "B"}
    cameras = {camera: {"serial": serials[camera]} for camera in serials}
    for camera, file in files.items():
        cameras[camera]["calibration"] = file
    rig.write_text(yaml.safe_dump({"cameras": cameras}))
    return rig


def test_both_formats_say_the_same_of_a_pair(rig: Path) -> None:
    by_ros = load_config(write(rig, left="left.yaml", right="right.yaml")).calibrations
    by_kalibr = load_config(write(rig, left="camchain.yaml", right="camchain.yaml")).calibrations
    for camera in ("left", "right"):
        assert by_ros[camera].projection == pytest.approx(by_kalibr[camera].projection, rel=1e-9)
    assert by_ros["right"].baseline_m == pytest.approx(0.0800, abs=1e-4)


@pytest.mark.parametrize(("scale", "said"), [(1.0, ""), (100.0, "the baseline is 8.003 m"), (0.05, "0.004002 m")])
def test_a_baseline_that_few_rigs_have_is_named_and_used(rig: Path, scale: float, said: str) -> None:
    right = ros("right")
    right["projection_matrix"]["data"][3] *= scale
    (rig.parent / "right.yaml").write_text(yaml.safe_dump(right))
    config = load_config(write(rig, left="left.yaml", right="right.yaml"))
    assert config.calibrations["right"].baseline_m == pytest.approx(0.0800 * scale, rel=1e-3)
    assert len(config.notes) == bool(said)
    assert all(note.startswith("cameras.right.calibration: ") and said in note for note in config.notes)


def test_files_are_read_once(rig: Path) -> None:
    config = load_config(write(rig, left="left.yaml", right="right.yaml"))
    (rig.parent / "left.yaml").unlink()
    assert config.calibrations["left"].width == 720
    assert load_config(write(rig)).calibrations == {}


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"left": "none.yaml"}, "cameras.left.calibration: .*none.yaml: cannot be read"),
        (
            {"right": "left.yaml"},
            "cameras.right.calibration: .*left.yaml: camera_name is 'left', but this is the right",
        ),
        ({"left": "right.yaml"}, "cameras.left.calibration: .*right.yaml: camera_name is 'right'"),
        ({"left": "rig.yaml"}, "cameras.left.calibration: .*rig.yaml: has no camera in its keys .'cameras'.: give"),
        ({"left": "/dev/zero"}, "cameras.left.calibration: /dev/zero: cannot be read .a device, not a regular file"),
        ({"left": "left.yaml", "right": "alone.yaml"}, "cameras.right.calibration: projection_matrix has no baseline"),
        ({"left": "other.yaml"}, "cameras.left.calibration: .*other.yaml: serial is C, but this is camera A"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_by_key_and_file(rig: Path, files: dict[str, str], words: str) -> None:
    for name, spoilt in (("alone", {"camera_name": "cam"}), ("other", {"serial": "C"})):
        (rig.parent / f"{name}.yaml").write_text(yaml.safe_dump(ros("left") | spoilt))
    with pytest.raises(ConfigurationError, match=f"rig.yaml: {words}") as caught:
        load_config(write(rig, **files))
    assert "\n" not in str(caught.value)


WHITE = np.full((540, 720), 255, np.uint8)


@pytest.mark.parametrize(
    ("file_name", "picture", "words"),
    [
        ("mask.jpg", WHITE, ["not a PNG"]),
        ("mask.png", np.zeros((540, 720), np.uint8), ["entirely black"]),
        ("mask.png", np.full((540, 720), 65535, np.uint16), ["8-bit grey"]),
        ("mask.png", np.full((540, 720, 3), 255, np.uint8), ["8-bit grey"]),
        ("mask.png", np.pad(np.full((2, 2), 255, np.uint8), 269), ["no pixel"]),
    ],
)
def test_a_mask_that_cannot_be_used_is_named_with_file_and_key(
    tmp_path: Path, file_name: str, picture: NDArray[np.uint8], words: list[str]
) -> None:
    assert cv2.imwrite(str(tmp_path / file_name), picture)
    message = complaint(tmp_path, LEFT + f"control: {{roi: {{left: {{mask: {file_name}}}}}}}")
    for word in ["control.roi.left", str(tmp_path / file_name), *words]:
        assert word in message


@pytest.mark.parametrize("odd", ["pipe", "/dev/zero", "/dev/kmsg", "."])
@pytest.mark.parametrize(
    "text",
    [
        "",
        "cameras: {left: {serial: A, response: FILE}}",
        "cameras: {left: {serial: A, gain_calibration: FILE}}",
        "cameras: {left: {serial: A, vignetting: FILE}}",
        LEFT + "control: {roi: {left: {mask: FILE}}}",
        LEFT + "publish: {zenoh: FILE}",
    ],
)
def test_pipes_devices_and_folders_are_refused_wherever_a_file_is_named(tmp_path: Path, text: str, odd: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    file = tmp_path / "rig.yaml"
    if text:
        file.write_text(text.replace("FILE", odd))
    else:
        file.symlink_to(tmp_path / odd)
    with pytest.raises(ConfigurationError, match=r"rig\.yaml: .*cannot be read.*a (named pipe|device|directory), not "):
        load_config(file)


def test_regions_are_read_relative_to_the_configuration(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "left.png"), WHITE)
    text = (
        "cameras: {left: {serial: A}, right: {serial: B}}\n"
        "control: {roi: {left: {mask: left.png},"
        " right: {background_weight: 0.5, rectangles: [{box: [0, 0, 720, 100], weight: 0}, {box: [8, 9, 30, 40]}]}}}\n"
    )
    regions = load(tmp_path, text).control.regions
    assert regions["left"].mask is not None and (regions["left"].mask == 255).all()
    assert regions["right"].mask is None
    assert regions["right"].background_weight == 0.5
    assert regions["right"].rectangles == (Rectangle(0, 0, 720, 100, 0.0), Rectangle(8, 9, 30, 40, 1.0))


def test_a_file_is_read_beside_the_configuration_and_refused_for_another_camera(tmp_path: Path) -> None:
    camera = CameraIdentity("Maker", "Model 7", "B")
    scale, lens = GainScale("GainRaw", (0.0, 240.0), (0.0, 24.0)), Vignetting(720, 540, (359.5, 269.5), (-0.5,))
    GainFile(scale, camera=camera).save(tmp_path / "gain_calibration.yaml")
    VignettingFile(lens, camera=camera).save(tmp_path / "vignetting.yaml")
    ResponseFile(ResponseFunction.linear(), Origin(camera, PixelFormat.MONO8)).save(tmp_path / "response.yaml")
    files = ", ".join(f"{key}: {key}.yaml" for key in ("gain_calibration", "vignetting", "response"))
    config = load(tmp_path, f"cameras: {{left: {{serial: B, {files}}}, right: {{serial: C}}}}")
    assert config.gain_scales == {"left": scale, "right": None}
    assert {name: file.vignetting for name, file in config.vignettings.items()} == {"left": lens}
    for key in ("gain_calibration", "vignetting", "response"):
        said = complaint(tmp_path, f"cameras: {{left: {{serial: A, {key}: {key}.yaml}}}}")
        assert f"cameras.left.{key}" in said and "camera.serial is B, but this is camera A" in said
    config.check_frames("left", CameraDescription("Maker", "Model 7", "B", size=(720, 540)))
    with pytest.raises(ConfigurationError, match="is for frames of 720x540 pixels, but camera B sends 640x480"):
        config.check_frames("left", CameraDescription("Maker", "Model 7", "B", size=(640, 480)))
    text = "cameras: {left: {serial: B, response: response.yaml}}\nimage: {pixel_format: Mono12}"
    assert "pixel_format is Mono8" in complaint(tmp_path, text)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (np.random.default_rng(0).bytes(500), "UTF-8"),
        (b"{mode: 'peer'", "line 1"),
        (b"{mode: 'pear'}", "pear"),
        (b"{endpoint: 'tcp/1.2.3.4:7447'}", "endpoint"),
        (b"", "mpty"),
        (b"[" * 200_000, "nests"),
    ],
)
def test_a_file_that_zenoh_cannot_use_is_refused_at_once(tmp_path: Path, content: bytes, word: str) -> None:
    """It was called valid, and then tried again for ever."""
    (tmp_path / "z.json5").write_bytes(content)
    imu = "motion: {imu: {key: imu/data, zenoh: z.json5}}\ncontrol: {focal_length_px: 800}"
    for section in ("publish: {zenoh: z.json5}", imu):
        said = complaint(tmp_path, LEFT + section)
        assert "z.json5 is not a configuration of zenoh" in said and word in said
        assert len(said) < 500 and "\n" not in said


def test_without_zenoh_the_daemon_goes_on_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    really_import = builtins.__import__

    def without_zenoh(name: str, *rest: Any) -> Any:
        if name in ("autoexpose_daemon.publish.publisher", "autoexpose_daemon.publish.inbound"):
            raise ModuleNotFoundError("No module named 'zenoh'", name="zenoh")
        return really_import(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_zenoh)
    config = load(tmp_path, LEFT + "publish: {}\nmotion: {imu: {key: imu/data}}\ncontrol: {focal_length_px: 800}")
    daemon = add_outlets(Daemon(config, {}), config)
    assert daemon.outlets == []
    assert daemon.telemetry.publishing is not None
    assert "zenoh is missing" in daemon.telemetry.publishing.trouble
    assert "autoexpose-daemon[publish]" in caplog.text
    assert daemon._control.sources["angular_rate_rad_s"](0) is None
    assert daemon.telemetry.imu is not None
    assert "zenoh is missing" in daemon.telemetry.imu.trouble
