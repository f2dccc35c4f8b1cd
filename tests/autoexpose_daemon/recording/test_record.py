"""Recording a daemon in real time, and replaying what it did."""

from __future__ import annotations

import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from autoexpose_daemon.recording.file import LoopState, Setup, Step
from autoexpose_daemon.recording.read import Recording
from autoexpose_daemon.recording.replay import report_replay
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE, PATIENCE_S, running_service
from tests.autoexpose_daemon.stereo import stereo_cameras
from tests.fakes import FakeCamera


def autoexpose(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*AUTOEXPOSE, *arguments], capture_output=True, text=True, timeout=60, check=False)


def configuration(folder: Path, left: FakeCamera, right: FakeCamera) -> Path:
    file = folder / "rig.yaml"
    file.write_text(f"cameras: {{left: {{serial: {left.serial}}}, right: {{serial: {right.serial}}}}}")
    return file


def wait_until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        threading.Event().wait(0.01)


@pytest.mark.realtime
def test_the_last_second_is_written_on_a_signal_and_at_the_end_and_replayed_bit_for_bit(tmp_path: Path) -> None:
    command = ["record", str(tmp_path / "last.mcap"), "--last", "1"]
    with (
        stereo_cameras("--still") as (left, right, _),
        running_service(configuration(tmp_path, left, right), command=command) as daemon,
    ):
        daemon.wait_for("READY=1")
        daemon.process.send_signal(signal.SIGUSR1)
        wait_until((tmp_path / "last-1.mcap").exists)
    files = sorted(tmp_path.glob("*.mcap"))
    assert [file.name for file in files] == ["last-1.mcap", "last-2.mcap"]
    for file in files:
        assert [type(item) for item in list(Recording(file))[:3]] == [Setup, Step, LoopState]
    said: list[str] = []
    assert report_replay(files[1], None, said.append), said
    assert re.search(r"replayed: (\d+), of which \1 are bit for bit as recorded", "\n".join(said))


def test_what_is_no_recording_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "notes.mcap"
    path.write_text("Buy milk")
    result = autoexpose("replay", str(path))
    assert result.returncode == 1
    assert result.stderr == f"autoexpose: {path}: is not an MCAP file, or is damaged from its first bytes on\n"


def test_a_policy_to_replay_that_does_not_exist_is_named_with_a_near_one(tmp_path: Path) -> None:
    result = autoexpose("replay", str(tmp_path / "run.mcap"), "--policy", "begin2021")
    assert result.returncode == 1
    assert result.stderr.startswith("autoexpose: there is no policy 'begin2021'; did you mean begin2022?")


def test_a_policy_that_is_no_longer_here_names_the_one_in_its_place(tmp_path: Path) -> None:
    result = autoexpose("replay", str(tmp_path / "run.mcap"), "--policy", "fisher-map")
    assert result.returncode == 1
    assert result.stderr.startswith("autoexpose: there is no policy 'fisher-map'; belief took the place of fisher-map;")


@pytest.mark.parametrize("last", [(), ("--last", "5")])
def test_a_file_that_is_not_named_as_a_recording_is_refused_at_once(tmp_path: Path, last: tuple[str, ...]) -> None:
    config, path = tmp_path / "rig.yaml", tmp_path / "x.txt"
    config.write_text("cameras: {left: {serial: A}}")
    result = autoexpose("record", str(path), "-c", str(config), *last)
    assert result.returncode == 1
    assert result.stderr == f"autoexpose: {path}: is not a name for a recording: it must end in .mcap\n"


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    config, path = tmp_path / "rig.yaml", tmp_path / "run.mcap"
    config.write_text("cameras: {left: {serial: A}}")
    path.write_text("precious")
    result = autoexpose("record", str(path), "-c", str(config))
    assert result.returncode == 1
    assert result.stderr == f"autoexpose: {path}: already exists: name a new file\n"
    assert path.read_text() == "precious"
