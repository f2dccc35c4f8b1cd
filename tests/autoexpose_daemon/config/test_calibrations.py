"""Calibration files in a configuration: found, read once, and refused by key and file."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from autoexpose_daemon.config.load import load_config
from imaging.errors import ConfigurationError
from tests.calibration.geometry.written import camchain, ros


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    for side in ("left", "right"):
        (tmp_path / f"{side}.yaml").write_text(yaml.safe_dump(ros(side)))
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(camchain()))
    return tmp_path / "rig.yaml"


def write(rig: Path, **files: str) -> Path:
    serials = {"left": "A", "right": "B"}
    cameras = {side: {"serial": serials[side]} for side in serials}
    for side, file in files.items():
        cameras[side]["calibration"] = file
    rig.write_text(yaml.safe_dump({"cameras": cameras}))
    return rig


def test_both_formats_say_the_same_of_a_pair(rig: Path) -> None:
    by_ros = load_config(write(rig, left="left.yaml", right="right.yaml")).calibrations
    by_kalibr = load_config(write(rig, left="camchain.yaml", right="camchain.yaml")).calibrations
    for side in ("left", "right"):
        assert by_ros[side].projection == pytest.approx(by_kalibr[side].projection, rel=1e-9)
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
