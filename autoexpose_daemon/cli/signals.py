"""Signals that end a command."""

from __future__ import annotations

import signal
import threading


def set_from_handler(event: threading.Event) -> None:
    """Set an event from a signal handler, on another thread: the interrupted one may be holding the event's lock."""
    if not event.is_set():  # if it is set, this process may be ending, and can start no thread
        threading.Thread(target=event.set).start()


def stop_on_signals(stop: threading.Event) -> None:
    """Have SIGTERM and SIGINT stop cleanly."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: set_from_handler(stop))
