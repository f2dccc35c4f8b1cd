"""Fake cameras forked from a process that has already spent the seconds of imports and of painting a room.

For test suites. As with all of multiprocessing, a script that uses it needs ``if __name__ == "__main__":``.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection

from fake_camera.__main__ import main
from fake_camera.bench.process import STOP_TIMEOUT_S, CameraProcess, NotStartedError

NURSERY = multiprocessing.get_context("forkserver")
NURSERY.set_forkserver_preload(["pytest", f"{__package__}.preload"])


@contextlib.contextmanager
def forked(arguments: Sequence[str]) -> Iterator[CameraProcess]:
    """A `Start`, some 0.1 s."""
    reader, writer = NURSERY.Pipe(duplex=False)
    process = NURSERY.Process(target=_be_a_camera, args=(list(arguments), writer))
    process.start()
    writer.close()

    def kill() -> None:
        process.kill()
        process.join()

    with reader, open(reader.fileno(), closefd=False) as output:
        try:
            ready = output.readline()
            if not ready:
                raise NotStartedError(f"a fake camera did not start with {' '.join(arguments)}")
            yield CameraProcess(ready, kill)
        finally:
            process.terminate()
            process.join(STOP_TIMEOUT_S)
            stopped = process.exitcode is not None
            kill()
            assert stopped, f"a fake camera with {' '.join(arguments)} did not stop within {STOP_TIMEOUT_S:g} s"


def _be_a_camera(arguments: list[str], output: Connection) -> None:
    """What the command line does, with `output` for its standard output."""
    os.dup2(output.fileno(), 1)
    sys.exit(main(arguments))
