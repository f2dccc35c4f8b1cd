"""A copy of the project in which a mutant lives and is tested; the work tree is never touched."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

NOT_COPIED = (".git", ".venv", "build", "out", "*.egg-info", ".hypothesis", ".*_cache")
MEMORY = 8 << 30
"""Bytes of address space; a mutant may ask for all there is."""


@dataclass(frozen=True, slots=True)
class Ended:
    """How pytest ended: its exit status, negative for a signal, None after the time-out; and what it printed."""

    status: int | None
    output: str

    @property
    def all_failed(self) -> list[str]:
        """The tests that failed, and what could not be imported."""
        return re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", self.output, re.MULTILINE)

    @property
    def failed(self) -> str | None:
        """The first of them."""
        return next(iter(self.all_failed), None)


class Workplace:
    """A copy of the project."""

    def __init__(self, project: Path, place: Path) -> None:
        self.root = place
        self._running: subprocess.Popen[str] | None = None
        shutil.copytree(project, place, ignore=shutil.ignore_patterns(*NOT_COPIED))

    @contextmanager
    def holding(self, path: str, text: str) -> Iterator[None]:
        """While inside, the file at `path` has another text."""
        file = self.root / path
        original = file.read_text()
        self._write(file, text)
        try:
            yield
        finally:
            self._write(file, original)

    def pytest(self, arguments: Sequence[str], timeout_s: float, variables: Mapping[str, str] | None = None) -> Ended:
        """Run pytest on tests of the copy, which import the copy."""
        options = ["-p", "no:cacheprovider", "--override-ini", "addopts=", "-q", "-rfE", "--tb=no", "--no-header"]
        process = subprocess.Popen(
            ["prlimit", f"--as={MEMORY}", sys.executable, "-m", "pytest", *options, *arguments],
            cwd=self.root,
            env=os.environ | {"PYTHONPATH": str(self.root), "OPENBLAS_NUM_THREADS": "1"} | dict(variables or {}),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._running = process
        try:
            output, _ = process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            return Ended(None, "")
        finally:
            self.stop()
            process.communicate()
            self._running = None
        return Ended(process.returncode, output)

    def stop(self) -> None:
        """End what runs here, with all that it has started."""
        if self._running is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._running.pid, signal.SIGKILL)

    @staticmethod
    def _write(file: Path, text: str) -> None:
        file.write_text(text)
        # Python takes compiled code for fresh when size and second of the source agree.
        Path(importlib.util.cache_from_source(str(file))).unlink(missing_ok=True)
