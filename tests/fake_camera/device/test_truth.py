"""The truth file: one JSON line for each pulse, at once and in order."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from queue import Queue

import pytest

from fake_camera.device.line0 import Line0
from fake_camera.device.truth import TruthFile
from fake_camera.imaging import ExposedFrame
from tests.fake_camera.gige.gige_client import device

EPOCH_NS = 7_000_000_000


def test_writes_a_line_for_each_pulse(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    truth = TruthFile(path, lambda time_s: 100 + time_s, Line0(EPOCH_NS, 100.0))
    for pulse in (0, 1, 50):
        truth.record(pulse)
    truth.close()
    assert [json.loads(line) for line in path.read_text().splitlines()] == [
        {"host_time_ns": EPOCH_NS, "lux": 100.0, "trigger": 0},
        {"host_time_ns": EPOCH_NS + 10_000_000, "lux": 100.01, "trigger": 1},
        {"host_time_ns": EPOCH_NS + 500_000_000, "lux": 100.5, "trigger": 50},
    ]


def test_writes_a_line_for_an_exposure_that_no_pulse_started(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    truth = TruthFile(path, lambda time_s: 100 + time_s, Line0(EPOCH_NS, 100.0))
    with device(truth=truth) as camera:
        frames: Queue[ExposedFrame] = Queue()
        camera.connect(frames.put)
        camera.features.set("TriggerMode", "On")
        camera.features.set("TriggerSource", "Software")
        camera.execute("AcquisitionStart")
        camera.execute("TriggerSoftware")
        frame = frames.get(timeout=20)
    truth.close()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    (seen,) = (line for line in lines if line["trigger"] is None)
    assert (seen["frame_id"], seen["device_time_ns"]) == (1, frame.device_time_ns)
    assert seen["lux"] == pytest.approx(100 + (seen["host_time_ns"] - EPOCH_NS) * 1e-9, abs=1e-5)


def test_a_pulse_is_in_the_file_before_the_next_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    asked = threading.Event()

    def lux(time_s: float) -> float:
        if time_s > 0:
            asked.set()
        return 1.0

    truth = TruthFile(path, lux, Line0(EPOCH_NS, 100.0))
    truth.record(0)
    truth.record(1)
    assert asked.wait(5)  # the light at pulse 1 is evaluated, so the line of pulse 0 is written
    assert len(path.read_text().splitlines()) >= 1
    truth.close()


def test_recording_does_not_wait_for_the_light(tmp_path: Path) -> None:
    go = threading.Event()

    def slow_lux(_: float) -> float:
        return 1.0 if go.wait(5) else 0.0

    truth = TruthFile(tmp_path / "truth.jsonl", slow_lux, Line0(EPOCH_NS, 100.0))
    for pulse in range(100):
        truth.record(pulse)  # returns although no line can be written yet
    assert (tmp_path / "truth.jsonl").read_text() == ""
    go.set()
    truth.close()
    assert len((tmp_path / "truth.jsonl").read_text().splitlines()) == 100


@pytest.mark.timeout(20)
def test_a_pipe_that_nobody_reads_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "truth")
    for path in (tmp_path / "truth", tmp_path / "nowhere" / "truth"):
        with pytest.raises(OSError, match="truth"):
            TruthFile(path, lambda _: 1.0, Line0(EPOCH_NS, 100.0))


def test_a_full_disk_is_said_once_and_ends_the_file_only(capfd: pytest.CaptureFixture[str]) -> None:
    truth = TruthFile(Path("/dev/full"), lambda _: 1.0, Line0(EPOCH_NS, 100.0))
    for pulse in range(7, 20):
        truth.record(pulse)
    truth.close()
    said = capfd.readouterr().err
    assert "/dev/full: No space left" in said and "before pulse 7" in said and said.count("\n") == 1


def test_a_nearly_full_disk_ends_the_file_with_the_line_that_does_not_fit(tmp_path: Path) -> None:
    """In a process of its own, whose files may have 80 bytes at most: one line and a half; then there is room again."""
    script = f"""if True:
        from pathlib import Path
        from resource import RLIM_INFINITY, RLIMIT_FSIZE, setrlimit
        from fake_camera.device.line0 import Line0
        from fake_camera.device.truth import TruthFile

        def lux(time_s):
            if time_s > 0.015:
                setrlimit(RLIMIT_FSIZE, (RLIM_INFINITY, RLIM_INFINITY))
            return 1.0

        setrlimit(RLIMIT_FSIZE, (80, RLIM_INFINITY))
        truth = TruthFile(Path({str(tmp_path / "truth")!r}), lux, Line0(0, 100.0))
        for pulse in range(4):
            truth.record(pulse)
        truth.close()
    """
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    first, half = (tmp_path / "truth").read_text().split("\n")
    assert json.loads(first)["trigger"] == 0
    assert len(half) == 80 - len(first) - 1
    assert "File too large" in ended.stderr and "before pulse 1" in ended.stderr
