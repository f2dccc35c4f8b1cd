"""What runs beside a test, and waiting for what it brings about."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

T = TypeVar("T")
PATIENCE_S = 20.0


@contextlib.contextmanager
def meanwhile(run: Callable[[threading.Event], object]) -> Iterator[None]:
    """Run this on a thread until the block ends; it gets the event that is set then."""
    stop = threading.Event()
    thread = threading.Thread(target=run, args=(stop,))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def wait_until(condition: Callable[[], T]) -> T:
    """Wait until it is true; returns what it gives."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (outcome := condition()):
        assert time.monotonic() < deadline_s, "it did not happen in time"
        time.sleep(0.002)
    return outcome
