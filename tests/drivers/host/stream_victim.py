"""A process that streams from a camera through stock Aravis, to be sent hostile packets.

    python -m tests.drivers.host.stream_victim SERIAL [--unfiltered]

It prints how many frames came and how many of them had holes, at every tenth, until its standard input ends. It may use
4 GB of memory, so that what asks for more ends it at once.
"""

from __future__ import annotations

import contextlib
import os
import resource
import select
import socket
import sys
from pathlib import Path

from drivers.aravis import open_camera
from drivers.camera import IncompleteFrame
from drivers.config.setup import CameraSetup, TriggerSetup

RATE_HZ = 30.0
FRAMES_A_LINE = 10

_SO_DETACH_FILTER = 27  # asm-generic/socket.h
_MOST_MEMORY_BYTES = 4 << 30


def main(serial: str, unfiltered: bool) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY_BYTES, _MOST_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    camera = open_camera(serial, CameraSetup(TriggerSetup("free_run", rate_hz=RATE_HZ)))
    if unfiltered:
        detach_filters()
    camera.start()
    frames = incomplete = 0
    while not select.select([sys.stdin], [], [], 0)[0]:
        frame = camera.next_frame(0.1)
        frames += frame is not None
        incomplete += isinstance(frame, IncompleteFrame)
        if frame is not None and frames % FRAMES_A_LINE == 0:
            print(frames, incomplete, flush=True)
    camera.close()


def detach_filters() -> None:
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(int(link.name))) as own:
            own.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)  # an error for one that has none


if __name__ == "__main__":
    main(sys.argv[1], "--unfiltered" in sys.argv[2:])
