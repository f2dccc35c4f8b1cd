"""Beside programs that take all processors: pairs without a decision, with the unit's priority and without any.

The ratio of both is what counts, taken in turns on one machine. The cameras themselves are not slowed down: robots' are
not, either.
"""

from __future__ import annotations

import configparser
import contextlib
import itertools
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import yaml

from fake_camera.bench import gige_camera
from fake_camera.bench.process import CameraProcess
from tests import REPOSITORY
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE
from tests.fakes import unique

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(400),
    pytest.mark.skipif(os.geteuid() != 0, reason="only root may raise a priority"),
]

ROUNDS = 2
SECONDS = 8.0
RATE_HZ = 30.0  # at which two rendered cameras leave something of two processors
FEWEST = 20
LOOPS = 2 * (os.cpu_count() or 1)
UNPRIVILEGED = ["setpriv", "--bounding-set", "-sys_nice"]
"""The daemon may not raise its priority: as before it had one."""

BESIDE_LOOPS = f'for i in $(seq {LOOPS}); do while :; do :; done & done; exec "$@"'
"""The worst case: they are of the daemon's own session, as if one script had started all."""


def as_the_unit() -> list[str]:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.read(REPOSITORY / "systemd/autoexpose.service")
    return ["nice", "-n", unit["Service"]["Nice"]]


@contextlib.contextmanager
def undisturbed(arguments: Sequence[str]) -> Iterator[CameraProcess]:
    """The start of a camera that comes before all others."""
    command = ["nice", "-n", "-20", sys.executable, "-m", "fake_camera", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        with contextlib.suppress(OSError):  # a kernel without groups of sessions
            Path(f"/proc/{process.pid}/autogroup").write_text("-20")
        yield CameraProcess(process.stdout.readline(), process.kill)
        process.terminate()
        process.communicate()


def counted(log: Path, words: str) -> int:
    """A count of the daemon's last line."""
    (last,) = [line for line in log.read_text().splitlines() if "stopped:" in line]
    found = re.search(words, last)
    return int(found[1]) if found else 0


def run(config: Path, log: Path, priority: Sequence[str]) -> tuple[int, int]:
    """Pairs without a decision, and all pairs, of a daemon beside busy loops."""
    command = [*priority, "sh", "-c", BESIDE_LOOPS, "sh", *AUTOEXPOSE, "run", "--config", str(config)]
    with log.open("w") as output, subprocess.Popen(command, stderr=output, start_new_session=True) as process:
        try:
            deadline_s = time.monotonic() + 60
            while "state exposing" not in log.read_text():
                assert process.poll() is None and time.monotonic() < deadline_s, log.read_text()
                time.sleep(0.1)
            time.sleep(SECONDS)
            process.terminate()
            process.wait(30)
        finally:
            os.killpg(process.pid, signal.SIGKILL)
    return counted(log, r"pairs without a decision: (\d+)"), counted(log, r"(\d+) pairs;")


def test_priority_leaves_a_fifth_of_the_pairs_without_a_decision(tmp_path: Path) -> None:
    wire = unique("wire")
    with contextlib.ExitStack() as stack:
        cameras = {
            name: stack.enter_context(
                gige_camera(side=name, line0=wire, options=["--line0-rate-hz", f"{RATE_HZ}"], start=undisturbed)
            )
            for name in ("left", "right")
        }
        config = tmp_path / "rig.yaml"
        serials = {name: {"serial": camera.serial} for name, camera in cameras.items()}
        config.write_text(yaml.safe_dump({"cameras": serials, "trigger": {"rate_hz": RATE_HZ}}))
        priorities = {"none": UNPRIVILEGED, "unit": as_the_unit()}
        found: dict[str, list[tuple[int, int]]] = {name: [] for name in priorities}
        for turn, (name, priority) in itertools.product(range(ROUNDS), priorities.items()):
            found[name].append(run(config, tmp_path / f"{name}-{turn}.log", priority))
    (before, pairs_before), (after, pairs_after) = (
        [sum(counts) for counts in zip(*each, strict=True)] for each in found.values()
    )
    told = f"without a decision: {before} of {pairs_before} pairs without priority, {after} of {pairs_after} with it"
    print(told)
    if before < FEWEST:
        pytest.skip(f"{LOOPS} busy loops do not disturb this machine ({told})")
    assert after / pairs_after <= before / pairs_before / 5, told
