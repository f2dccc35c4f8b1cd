"""Work for the workers of a cluster, which import it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

import cv2


def roots(numbers: Sequence[float], *, threads: bool = False) -> list[float]:
    """Numbers that differ from machine to machine if anything does; with `threads` also how many OpenCV has."""
    return [each**0.5 for each in numbers] + ([float(cv2.getNumThreads())] if threads else [])


def dies_first(marks: str, times: int) -> int:
    """Takes its process with it so many times, each noted in a folder."""
    before = len(list(Path(marks).iterdir()))
    if before < times:
        (Path(marks) / f"{os.getpid()}-{time.monotonic_ns()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return before
