"""A zenoh router in a process of its own: a session with `mode: router`, configured by the file that is named."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import zenoh


def main(file: str) -> None:
    with zenoh.open(zenoh.Config.from_file(file)):
        print("ready", flush=True)
        sys.stdin.read()


@contextlib.contextmanager
def router(file: Path) -> Iterator[None]:
    """Run this file until the block ends."""
    command = [sys.executable, "-m", "tests.autoexpose_daemon.publish.router", str(file)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield
        finally:
            process.kill()


if __name__ == "__main__":
    main(sys.argv[1])
