"""Signals that end a camera."""

from __future__ import annotations

import select
import signal
import threading
from typing import TextIO

_TURN_S = 0.5


def stopped_by_signals() -> threading.Event:
    """Set at SIGTERM and SIGINT; on another thread, as the interrupted one may be holding its lock."""
    stop = threading.Event()

    def end(*_: object) -> None:
        if not stop.is_set():  # else this process may be ending, and begins no thread
            threading.Thread(target=stop.set).start()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    return stop


def wait_for(stop: threading.Event) -> None:
    """Wait on the main thread until `stop` is set.

    In turns: a signal that comes between Python's last look for signals and its wait does not interrupt the wait.
    """
    while not stop.wait(_TURN_S):
        pass


def wait_for_input(file: TextIO, stop: threading.Event) -> bool:
    """Wait until there is something to read, or its end; False if `stop` is set before.

    Reading itself would go on after a signal.
    """
    while not select.select([file], [], [], _TURN_S)[0]:
        if stop.is_set():
            return False
    return True
