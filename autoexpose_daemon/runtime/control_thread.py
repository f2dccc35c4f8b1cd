"""The daemon in its own thread."""

from __future__ import annotations

import threading

from autoexpose_daemon.runtime.daemon import Daemon


class ControlThread:
    """Runs a daemon until it is asked to stop; `error` is what ended it earlier."""

    def __init__(self, daemon: Daemon) -> None:
        self.error: BaseException | None = None
        self._daemon = daemon
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control")
        self._thread.start()

    def ask_to_stop(self) -> None:
        """Begin to stop: the cameras are freed first."""
        self._stop.set()

    def ended(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s` for it to end; returns whether it has."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._daemon.run(self._stop)
        except BaseException as error:
            self.error = error
