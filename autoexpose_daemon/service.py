"""Running the daemon in a process: its control thread, the live view, and what to do when a thread dies."""

from __future__ import annotations

import logging
import threading
import time

from rich.console import Console

from autoexpose_daemon.runtime import Daemon
from autoexpose_daemon.view import follow, set_up_logging

log = logging.getLogger(__name__)


def run_until_stopped(daemon: Daemon, stop: threading.Event, console: Console, title: str) -> None:
    """Run the control thread beside the live view until `stop` is set.

    Raises
    ------
    Exception
        Whatever ended any thread: a daemon with a dead thread must not look alive.
    """
    set_up_logging(console)
    failures: list[BaseException] = []

    def fail(error: BaseException) -> None:
        failures.append(error)
        stop.set()

    def control() -> None:
        try:
            daemon.run(stop)
        except BaseException as error:
            fail(error)

    threading.excepthook = lambda args: fail(args.exc_value or RuntimeError("a thread died"))
    thread = threading.Thread(target=control, name="control")
    thread.start()
    try:
        follow(daemon.telemetry, stop, console, title)
    finally:
        stop.set()
        thread.join()
    if failures:
        raise failures[0]
    log.info("stopped: %s", daemon.telemetry.line(time.monotonic_ns()))
