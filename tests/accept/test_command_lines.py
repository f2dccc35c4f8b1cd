"""The command lines of README and docs, word for word as the pages have them: tests/command_lines.yaml, `sessions`."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests import REPOSITORY
from tests.command_lines import readmes_rig, table

SESSIONS: dict[str, Any] = table()["sessions"]
PATIENCE_S = 90.0
BASH = ("env", "--default-signal=INT", "bash", "-euo", "pipefail", "-c")
"""A shell ignores SIGINT in what it starts in the background, and so would these commands if it started the tests."""


class Terminal:
    """A folder and an environment to type commands in; what runs in the background ends with it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        (folder / "bin").mkdir()
        (folder / "examples").symlink_to(REPOSITORY / "examples")
        (folder / "rig.yaml").write_text(readmes_rig())
        path = f"{folder / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        self._environment = {**os.environ, "PATH": path, "PYTHONPATH": str(REPOSITORY), "PYTHONUNBUFFERED": "1"}
        self._outputs = 0

    def type(self, step: str | Mapping[str, Any], pid: int = 0) -> None:
        """Run a line to its end, or as the step says."""
        if isinstance(step, str):
            with self._running(step.replace("PID", str(pid))) as (process, output):
                assert process.wait(PATIENCE_S) == 0, f"{step}\n{output.read_text()}"
            return
        with self._running(step["run"]) as (process, output):
            if "after" in step:
                wait_for(step["after"], process, output)
            for line in step.get("meanwhile", []):
                self.type(line, process.pid)
            if "seconds" in step:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(step["seconds"])
            process.send_signal(signal.SIGINT)  # unless it is done, as what shows things live off a terminal
            assert process.wait(PATIENCE_S) == 0, f"{step['run']}\n{output.read_text()}"

    @contextlib.contextmanager
    def in_background(self, line: str) -> Iterator[None]:
        """Run a line that ends in & until it says that it is ready; it ends with the block."""
        with self._running(line.removesuffix("&")) as (process, output):
            wait_for("\n", process, output)
            yield

    @contextlib.contextmanager
    def _running(self, line: str) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
        self._outputs += 1
        output = self._folder / f"{self._outputs}.out"
        # A single command replaces the shell, so that signals reach it.
        command = [*BASH, line if any(character in line for character in ";|&>") else f"exec {line}"]
        with output.open("wb") as file:
            process = subprocess.Popen(
                command, cwd=self._folder, env=self._environment, stdout=file, stderr=file, start_new_session=True
            )
        try:
            yield process, output
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            process.wait(PATIENCE_S)


def wait_for(words: str, process: subprocess.Popen[bytes], output: Path) -> None:
    """Wait until a process has printed this."""
    deadline_s = time.monotonic() + PATIENCE_S
    while words not in output.read_text():
        assert process.poll() is None and time.monotonic() < deadline_s, output.read_text()
        time.sleep(0.05)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SESSIONS)
def test_they_run(name: str, tmp_path: Path) -> None:
    terminal, session = Terminal(tmp_path), SESSIONS[name]
    with contextlib.ExitStack() as ends:
        for step in [*session.get("first", []), *session["lines"]]:
            if isinstance(step, str) and step.endswith("&"):
                ends.enter_context(terminal.in_background(step))
            else:
                terminal.type(step)
