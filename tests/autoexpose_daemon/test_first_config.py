"""`autoexpose init`: what it writes for the cameras that answer is a configuration, and runs."""

from __future__ import annotations

import itertools
import re
import signal
import subprocess
from pathlib import Path

import pytest

from autoexpose_daemon.cli.first_config import AskedCamera, first_config
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import load_config
from drivers.aravis import FoundCamera
from drivers.genicam.trigger import TriggerSources
from imaging.errors import ConfigurationError
from imaging.pixels import PixelFormat
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE, Within, autoexpose
from tests.autoexpose_daemon.stereo import stereo_cameras
from tests.fakes import fake_camera

MONO8, MONO12, RED = PixelFormat.MONO8, PixelFormat.MONO12, PixelFormat.BAYER_RG8


def asked(
    serial: str,
    lines: tuple[str, ...] | None = ("Line0", "Line3"),
    *,
    software: bool = True,
    ptp: bool = False,
    formats: tuple[PixelFormat, ...] = (MONO8, MONO12),
    present: PixelFormat | None = MONO8,
) -> AskedCamera:
    found = FoundCamera(serial, "Maker", "Model\x1b[2J", "gige", "192.168.0.2", "id")
    return AskedCamera(found, TriggerSources(lines, software, ptp), formats, present)


def written(tmp_path: Path, *rig: AskedCamera) -> tuple[str, Config]:
    file = tmp_path / "rig.yaml"
    file.write_text(first_config(rig, file))
    return file.read_text(), load_config(file)


def test_two_cameras_are_left_and_right_and_everything_else_is_the_default(tmp_path: Path) -> None:
    text, config = written(tmp_path, asked("1"), asked("A" * 60))
    assert {name: camera.serial for name, camera in config.cameras.items()} == {"left": "1", "right": "A" * 60}
    assert "swap" in text
    assert text.isascii() and text.isprintable() is False and "\x1b" not in text
    plain = Config.model_validate({"cameras": {"left": {"serial": "1"}, "right": {"serial": "A" * 60}}, "publish": {}})
    assert config == plain


def test_other_numbers_of_cameras_are_counted(tmp_path: Path) -> None:
    assert list(written(tmp_path, asked("A"))[1].cameras) == ["camera1"]
    assert list(written(tmp_path, *map(asked, "ABC"))[1].cameras) == ["camera1", "camera2", "camera3"]


def test_they_are_triggered_by_what_all_of_them_take(tmp_path: Path) -> None:
    by = {
        (asked("A", ("Line1", "Line3")), asked("B", ("Line3",))): ("external", "Line3"),
        (asked("A", None), asked("B")): ("external", "Line0"),
        (asked("A", ()), asked("B")): ("software", "Line0"),
        (asked("A", ("Line1",)), asked("B", ("Line2",))): ("software", "Line0"),
        (asked("A", (), software=False),): ("free_run", "Line0"),
    }
    for rig, (mode, line) in by.items():
        trigger = written(tmp_path, *rig)[1].trigger
        assert (trigger.mode, trigger.line) == (mode, line)
    with pytest.raises(ConfigurationError, match=r"A has no line; B has Line0 and software.*--camera"):
        written(tmp_path, asked("A", (), software=False), asked("B", ("Line0",)))


def test_ptp_is_named_where_all_have_it(tmp_path: Path) -> None:
    assert "mode ptp" in written(tmp_path, asked("A", ptp=True), asked("B", ptp=True))[0]
    assert "mode ptp" not in written(tmp_path, asked("A", ptp=True), asked("B"))[0]


def test_a_format_is_chosen_only_where_one_is_not_supported(tmp_path: Path) -> None:
    assert written(tmp_path, asked("A"), asked("B", present=MONO12))[1].image.pixel_format is None
    assert (
        written(tmp_path, asked("A", formats=(RED, MONO12), present=None), asked("B"))[1].image.pixel_format == MONO12
    )
    with pytest.raises(ConfigurationError, match="no pixel format in common"):
        written(tmp_path, asked("A", formats=(), present=None))


def test_no_camera_is_one_sentence_that_says_what_to_do(
    within: Within, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("drivers.aravis.find_cameras", list)
    file = tmp_path / "rig.yaml"
    assert "autoexpose doctor" in within.refused("init", "-o", str(file))
    assert not file.exists()


def test_a_file_that_is_there_stays(within: Within, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("mine")
    assert "--force" in within.refused("init", "-o", str(file))
    assert file.read_text() == "mine"


@pytest.mark.wire
def test_what_is_written_for_two_cameras_runs(
    tmp_path: Path, socket_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("something else")
    with stereo_cameras() as (left, right, _):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(socket_folder))  # a socket of another rig may be on this machine
        chosen = ("--camera", right.serial, "--camera", left.serial)
        result = autoexpose("init", "--force", "-o", str(file), *chosen)
        assert result.returncode == 0, result.stderr
        config = load_config(file)
        assert [camera.serial for camera in config.cameras.values()] == [right.serial, left.serial]
        assert (config.trigger.mode, config.trigger.line) == ("external", "Line0")
        assert re.search(rf"{right.serial}.*# Autoexpose .* at {right.address}", file.read_text())
        assert autoexpose("config", "check", "--camera", str(file)).returncode == 0
        with subprocess.Popen([*AUTOEXPOSE, "run", "-c", str(file)], stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            told = list(itertools.takewhile(lambda line: "exposing" not in line, iter(process.stderr.readline, "")))
            process.send_signal(signal.SIGTERM)
            _, rest = process.communicate(timeout=30)
    assert process.returncode == 0, [*told, rest]
    assert sum(line.endswith("ready\n") for line in told) == 2


@pytest.mark.wire
def test_a_serial_that_does_not_answer_is_refused_with_those_that_do(tmp_path: Path) -> None:
    with fake_camera() as camera:
        result = autoexpose("init", "-o", str(tmp_path / "rig.yaml"), "--camera", "NOBODY")
    assert result.returncode == 1
    assert "NOBODY" in result.stderr and camera.serial in result.stderr
