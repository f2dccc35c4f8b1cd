"""Each program in examples/ does what its first line says, over the wire, as a process of its own."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from autoexpose_daemon.runtime.daemon import Daemon
from tests import REPOSITORY
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.recording.runs import VirtualRun, record
from tests.autoexpose_daemon.scripted import scripted_daemon

EXAMPLES = REPOSITORY / "examples"
TESTED_HERE = {"client", "control", "imu", "light_ahead", "orb_consumer", "read_recording", "steering"}
TESTED_HERE |= {"test_with_fake_cameras"}

pytestmark = pytest.mark.usefixtures("brisk")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(REPOSITORY), "PYTHONWARNINGS": "error"}


@contextmanager
def running(example: str, *arguments: str) -> Iterator[Callable[[str], str]]:
    """The program until Ctrl-C; a function that waits for a line."""
    # A shell ignores SIGINT in what it starts in the background, and so would this if it started the tests.
    command = ["env", "--default-signal=INT", sys.executable, str(EXAMPLES / f"{example}.py"), *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=ENVIRONMENT) as process:
        assert process.stdout is not None and process.stderr is not None
        lines = iter(process.stdout.readline, "")
        try:
            yield lambda pattern: next(line for line in lines if re.search(pattern, line))
        finally:
            process.send_signal(signal.SIGINT)
            said = process.stderr.read()
    assert (process.returncode, said) == (0, "")


@contextmanager
def daemon_at(at: str, **sections: object) -> Iterator[Daemon]:
    with scripted_daemon(publish={"listen": [at]}, **sections) as (daemon, _, seen):
        wait_until(lambda: len(seen) > 5, "pairs")
        yield daemon


def test_every_example_is_tested_and_says_how_to_run_it() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == TESTED_HERE
    for path in [*EXAMPLES.glob("*.py"), *EXAMPLES.glob("*/*.py")]:
        text = path.read_text()
        assert text.count("\n") <= 40 and str(path.relative_to(REPOSITORY).parent) in text.partition("\n\n")[0]


@pytest.mark.wire
def test_client() -> None:
    at = endpoint()
    with daemon_at(at), running("client", at) as line:
        assert re.search(r"trigger \d+: left \d+ us .* dB, mean grey \d+, right \d+ us .*; next: ", line("next"))


@pytest.mark.wire
def test_steering() -> None:
    at = endpoint()
    with daemon_at(at) as daemon, running("steering", at) as line:
        line(r"[1-9]\d* of [1-9]\d* corners followed")
        tally = daemon.telemetry.tracking
        assert tally is not None
        wait_until(lambda: tally.by == ("corners",), "a decision that is steered")


@pytest.mark.wire
def test_imu() -> None:
    at = endpoint()
    imu = {"key": "autoexpose/rig/imu", "connect": [at], "max_age_s": 1.0}
    control = {"policy": "neves2009", "focal_length_px": 600}
    with daemon_at(at, control=control, motion={"imu": imu}) as daemon, running("imu", at):
        tally = daemon.telemetry.imu
        assert tally is not None
        wait_until(lambda: tally.angular_rate_rad_s == pytest.approx(0.5), "a decision by the IMU")


@pytest.mark.wire
def test_light_ahead() -> None:
    at = endpoint()
    with daemon_at(at) as daemon, running("light_ahead", at) as line:
        line(r"exposed at \d")
        tally = daemon.telemetry.light_ahead
        assert tally is not None
        wait_until(lambda: tally.belief is not None, "a decision that knows of the tunnel")
        assert not tally.refused


@pytest.mark.wire
def test_control() -> None:
    at = endpoint()
    command = [sys.executable, str(EXAMPLES / "control.py"), at]
    with daemon_at(at):
        ended = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, check=True, timeout=60)
    for part in ("locked at ", "EV -0.5", "to 4000 us", "refused: ", "no-such-policy", "nothing, after a reset"):
        assert part in ended.stdout


@pytest.mark.wire
def test_read_recording(tmp_path: Path) -> None:
    file = record(tmp_path / "run.mcap", VirtualRun("neves2009"), 12)
    command = [sys.executable, str(EXAMPLES / "read_recording.py"), str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, check=True, timeout=60)
    assert ended.stdout.startswith("policy neves2009, within ")
    assert ended.stdout.count("; next ") == 12
    assert "dropped by the recorder: 0" in ended.stdout
    nothing = subprocess.run([*command[:-1], "no.mcap"], capture_output=True, text=True, env=ENVIRONMENT, check=False)
    assert (nothing.returncode, nothing.stderr.count("\n")) == (1, 1)


@pytest.mark.realtime
def test_with_fake_cameras() -> None:
    # PyGObject warns when it is imported
    environment = ENVIRONMENT | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "PYTHONWARNINGS": ""}
    plugin = ("-c", os.devnull, "-p", "fake_camera.bench.pytest_plugin", "-p", "no:cacheprovider")
    command = [sys.executable, "-m", "pytest", "-q", *plugin, str(EXAMPLES / "test_with_fake_cameras.py")]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=110)
    assert ended.returncode == 0, ended.stdout + ended.stderr
