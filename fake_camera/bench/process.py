"""A fake camera's process: begun, waited for, ended."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

STOP_TIMEOUT_S = 10.0


class NotStartedError(RuntimeError):
    """A fake camera ended before it could be reached; the message has its reason."""


@dataclass(frozen=True, slots=True)
class CameraProcess:
    """A process that serves, from its first line on.

    Attributes
    ----------
    ready
        The line that it printed when it was ready.
    kill
        Ends it at once, and waits for that.
    """

    ready: str
    kill: Callable[[], None]


Start = Callable[[Sequence[str]], AbstractContextManager[CameraProcess]]
"""Runs a fake camera with these arguments of the command line until the context ends; raises `NotStartedError`."""


@contextlib.contextmanager
def started(arguments: Sequence[str]) -> Iterator[CameraProcess]:
    """The `Start` of a new interpreter: some two seconds."""
    package = __name__.rpartition(".bench.")[0]
    command = [sys.executable, "-m", package, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None

        def kill() -> None:
            process.kill()
            process.wait()

        try:
            ready = process.stdout.readline()
            if not ready:
                raise NotStartedError(process.stderr.read().strip())
            yield CameraProcess(ready, kill)
        finally:
            process.terminate()
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
