"""A process that streams from a camera through stock Aravis, to be sent hostile packets.

    python -m tests.drivers.host.stream_victim SERIAL [--unfiltered]

It prints how many frames came and how many of them had holes, at every tenth, until its standard input ends. It may use
4 GB of memory, so that what asks for more ends it at once.
"""

from __future__ import annotations

import errno
import os
import resource
import select
import sys

from drivers.aravis import open_camera, stream
from drivers.camera import IncompleteFrame
from drivers.setup import CameraSetup, TriggerSetup

RATE_HZ = 30.0
FRAMES_A_LINE = 10

_MOST_MEMORY_BYTES = 4 << 30


def main(serial: str, unfiltered: bool) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY_BYTES, _MOST_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if unfiltered:
        stream.StreamFilter = unsupported  # type: ignore[assignment, misc]
    camera = open_camera(serial, CameraSetup(TriggerSetup("free_run", rate_hz=RATE_HZ)))
    camera.start()
    frames = incomplete = 0
    while not select.select([sys.stdin], [], [], 0)[0]:
        frame = camera.next_frame(0.1)
        frames += frame is not None
        incomplete += isinstance(frame, IncompleteFrame)
        if frame is not None and frames % FRAMES_A_LINE == 0:
            print(frames, incomplete, flush=True)
    camera.close()


def unsupported(*_: object) -> None:
    raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))


if __name__ == "__main__":
    main(sys.argv[1], "--unfiltered" in sys.argv[2:])
