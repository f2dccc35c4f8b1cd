"""The latest faults in the log, kept in memory for the status."""

from __future__ import annotations

import logging
from collections import deque

from autoexpose_daemon.status.document import Fault
from documents.text import readable

KEPT_FAULTS = 50
LONGEST_TEXT = 500
"""Characters of a fault; the rest is cut off."""


class FaultLog(logging.Handler):
    """Keeps the last log records at WARNING and above, one line each."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._faults: deque[Fault] = deque(maxlen=KEPT_FAULTS)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Oldest first."""
        return tuple(self._faults.copy())  # an atomic copy: other threads append

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record."""
        try:
            text = readable(" ".join(record.getMessage().split()))
        except Exception:  # a message that does not fit its arguments must not stop the log
            self.handleError(record)
            return
        self._faults.append(Fault(round(record.created, 3), record.levelname, text[:LONGEST_TEXT]))


def fault_log() -> FaultLog:
    """The fault log of this process; it starts listening at the first call."""
    root = logging.getLogger()
    for handler in root.handlers:
        if isinstance(handler, FaultLog):
            return handler
    handler = FaultLog()
    root.addHandler(handler)
    return handler
