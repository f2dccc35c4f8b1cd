"""The latest faults in the log, kept in memory for whoever asks how the daemon is."""

from __future__ import annotations

import logging
from collections import deque

from autoexpose_daemon.status.document import Fault
from drivers.config.readable import readable

KEPT_FAULTS = 50
LONGEST_TEXT = 500
"""Characters of a fault."""


class FaultLog(logging.Handler):
    """Keeps the last events of the log at WARNING and above, a line each."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._faults: deque[Fault] = deque(maxlen=KEPT_FAULTS)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Oldest first."""
        return tuple(self._faults.copy())  # copied at one stroke: other threads add to it

    def emit(self, record: logging.LogRecord) -> None:
        """Keep an event."""
        try:
            text = readable(" ".join(record.getMessage().split()))
        except Exception:  # a message that does not fit its arguments; the log goes on
            self.handleError(record)
            return
        self._faults.append(Fault(round(record.created, 3), record.levelname, text[:LONGEST_TEXT]))


def fault_log() -> FaultLog:
    """The one of this process, which begins to listen when it is first asked for."""
    root = logging.getLogger()
    for handler in root.handlers:
        if isinstance(handler, FaultLog):
            return handler
    handler = FaultLog()
    root.addHandler(handler)
    return handler
