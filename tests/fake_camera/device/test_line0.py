"""The trigger wire: one grid and one numbering for all processes that name it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.line0 import Line0, WireError

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


_WATCHER = """
import json, sys, time
from pathlib import Path
from fake_camera.device.line0 import Line0
line0 = Line0.join("a", 100.0, Path(sys.argv[1]))
print("ready", flush=True)
sys.stdin.readline()
pulse = line0.first_pulse_after(time.monotonic_ns())
seen = []
for number in range(pulse, pulse + 40):
    time.sleep(max(0, line0.pulse_time_ns(number) - time.monotonic_ns()) * 1e-9)
    seen.append((number, line0.pulse_time_ns(number), time.monotonic_ns()))
print(json.dumps(seen))
"""


@pytest.mark.realtime
def test_two_processes_see_the_same_pulses_at_the_same_time(tmp_path: Path) -> None:
    watchers = [
        subprocess.Popen(
            [sys.executable, "-c", _WATCHER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    for watcher in watchers:
        assert watcher.stdout is not None
        assert watcher.stdout.readline() == "ready\n"
    for watcher in watchers:
        assert watcher.stdin is not None
        watcher.stdin.write("go\n")
        watcher.stdin.flush()
    answers = [watcher.communicate(timeout=30)[0] for watcher in watchers]
    left, right = ({number: (due, at) for number, due, at in json.loads(text)} for text in answers)
    common = left.keys() & right.keys()
    assert len(common) > 20
    assert all(left[number][0] == right[number][0] for number in common)
    skews_ns = sorted(abs(left[number][1] - right[number][1]) for number in common)
    period_ns = 10_000_000
    assert skews_ns[len(skews_ns) // 4] < period_ns / 5  # a busy machine has no time for some of them
