"""The wires between processes: triggers, exposures; and the truth of each pulse, a line of a file."""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path
from queue import Queue

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.exposure_wire import ExposureInput, ExposureOutput
from fake_camera.device.line0 import Line0, WireError
from fake_camera.device.truth import TruthFile
from fake_camera.imaging import ExposedFrame
from tests.fake_camera.gige.gige_client import device

EPOCH_NS = 5_000_000_000


def start_at(time_ns: int, name: str, directory: Path, rate_hz: float = 60.0) -> Line0:
    return Line0.join(name, rate_hz, directory, lambda: time_ns)


@given(
    rate_hz=st.floats(1, 1000),
    after_ns=st.integers(-(10**9), 10**15),
)
def test_the_next_pulse_is_the_first_later_one(rate_hz: float, after_ns: int) -> None:
    line0 = Line0(EPOCH_NS, rate_hz)
    pulse = line0.first_pulse_after(EPOCH_NS + after_ns)
    assert line0.pulse_time_ns(pulse) > EPOCH_NS + after_ns
    assert pulse == 0 or line0.pulse_time_ns(pulse - 1) <= EPOCH_NS + after_ns


def test_the_grid_does_not_drift() -> None:
    assert Line0(EPOCH_NS, 60.0).pulse_time_ns(60 * 3600) == EPOCH_NS + 3600 * 10**9


def test_the_grid_lives_as_long_as_anybody_holds_it(tmp_path: Path) -> None:
    first = start_at(1, "a", tmp_path)
    second = start_at(2, "a", tmp_path)
    other = start_at(5, "b", tmp_path)
    assert (first.epoch_ns, second.epoch_ns, other.epoch_ns) == (1, 1, 5)
    other.close()
    first.close()
    again = start_at(3, "a", tmp_path)
    assert again.epoch_ns == 1
    second.close()
    again.close()
    new = start_at(4, "a", tmp_path)
    assert new.epoch_ns == 4
    new.close()
    assert list(tmp_path.iterdir()) == []


def test_another_rate_is_refused(tmp_path: Path) -> None:
    first = start_at(1, "a", tmp_path)
    with pytest.raises(WireError, match="Line0 a runs at 60 Hz"):
        start_at(2, "a", tmp_path, rate_hz=30.0)
    first.close()
    start_at(3, "a", tmp_path, rate_hz=30.0).close()


@pytest.mark.parametrize("name", ["", "a/b", "x" * 65, "a b", "a\n", "\u65e5\u672c", "\u00e9"])
def test_a_name_is_a_word(tmp_path: Path, name: str) -> None:
    with pytest.raises(WireError, match="name"):
        Line0.join(name, 60.0, tmp_path)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_what_is_no_file_of_a_wire_is_neither_followed_nor_waited_for(tmp_path: Path, kind: str) -> None:
    path, others = tmp_path / "fake-camera-line0-a", tmp_path / "others"
    others.write_text("mine")
    {"pipe": os.mkfifo, "link": lambda path: path.symlink_to(others), "folder": Path.mkdir}[kind](path)
    with pytest.raises((WireError, OSError)) as refused:
        start_at(1, "a", tmp_path)
    assert str(path) in str(refused.value)
    assert others.read_text() == "mine"


def test_the_grid_of_a_killed_process_is_not_joined(tmp_path: Path) -> None:
    script = (
        "import os, signal, sys; from pathlib import Path; from fake_camera.device.line0 import Line0;"
        "print(Line0.join('a', 25.0, Path(sys.argv[1])).epoch_ns, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    killed = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False)
    assert killed.returncode == -9
    assert len(list(tmp_path.iterdir())) == 1
    line0 = Line0.join("a", 60.0, tmp_path)
    assert line0.epoch_ns > int(killed.stdout)
    line0.close()


def test_pulses_arrive_with_their_times_and_nothing_else_does(tmp_path: Path) -> None:
    pulses: Queue[int] = Queue()
    end, other = ExposureInput(tmp_path / "wire", pulses.put), ExposureOutput(tmp_path / "wire")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger:
        for datagram in (b"", b"short", struct.pack("=qq", 1, 2)):
            stranger.sendto(datagram, str(tmp_path / "wire"))
    other.rise(7)
    assert pulses.get(timeout=5) == 7
    other.close()
    end.close()
    assert list(tmp_path.iterdir()) == []


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
