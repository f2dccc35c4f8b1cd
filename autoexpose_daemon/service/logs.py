"""The log: coloured for a terminal, with priorities for systemd's journal, else as plain lines."""

from __future__ import annotations

import atexit
import logging
import os
import sys
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue
from types import TracebackType

from rich.console import Console
from rich.logging import RichHandler

from autoexpose_daemon.status.describe import fault_log
from documents.text import readable

log = logging.getLogger(__name__)

_LAYOUT = "\n\t"
_LAST_WORDS_S = 3.0

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
"""Syslog priorities by lowest log level; anything below has 7."""


def set_up_logging(console: Console) -> None:
    """Log INFO and above from our packages, WARNING and above from others, and the traceback that ends the program.

    A thread of its own writes: a terminal that takes nothing more, such as one over a lost connection, delays nobody.
    """
    if console.is_terminal:
        handler: logging.Handler = RichHandler(console=console, show_path=False, log_time_format="%H:%M:%S")
        handler.setFormatter(ReadableFormatter("%(message)s"))
    else:
        handler = logging.StreamHandler()
        handler.setFormatter(
            JournalFormatter("%(message)s") if _journal_reads() else ReadableFormatter("%(levelname)s %(message)s")
        )
        sys.excepthook = _log_last_words
    records: SimpleQueue[logging.LogRecord] = SimpleQueue()
    writer = LogWriter(records, handler)
    writer.start()
    atexit.register(writer.stop)
    handlers = [QueueHandler(records), fault_log()]
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=handlers, force=True)
    for package in ("autoexpose_daemon", "drivers"):
        logging.getLogger(package).setLevel(logging.INFO)


def complain(sentence: str) -> None:
    """Say on standard error why the program ends."""
    text = readable(f"autoexpose: {sentence}", _LAYOUT)
    print(_with_priority(logging.ERROR, text) if _journal_reads() else text, file=sys.stderr)


class LogWriter(QueueListener):
    """The thread that writes; where it is stuck, the program ends all the same."""

    def stop(self) -> None:
        """Have what is left written; if that takes longer than `_LAST_WORDS_S`, end the program without."""
        self.enqueue_sentinel()
        if self._thread is not None:
            self._thread.join(_LAST_WORDS_S)
            if self._thread.is_alive():  # and holds locks that the orderly end waits for
                os._exit(os.EX_IOERR)


class ReadableFormatter(logging.Formatter):
    """Lets no escape sequence through: names of cameras, consumers and files come from outside."""

    def format(self, record: logging.LogRecord) -> str:
        """The lines of a record."""
        return readable(super().format(record), _LAYOUT)


class JournalFormatter(ReadableFormatter):
    """Puts the priority before each line."""

    def format(self, record: logging.LogRecord) -> str:
        """The lines of a record."""
        return _with_priority(record.levelno, super().format(record))


def _with_priority(level: int, text: str) -> str:
    """The text with its priority before each line (sd-daemon(3)): the journal makes each line an entry."""
    priority = next((priority for least, priority in _PRIORITIES if level >= least), 7)
    return "\n".join(f"<{priority}>{line}" for line in text.splitlines())


def _journal_reads() -> bool:
    """Whether standard error goes to the journal; its device and inode are then in the environment."""
    try:
        stream = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):  # no such descriptor
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{stream.st_dev}:{stream.st_ino}"


def _log_last_words(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    log.critical("ended by %s", kind.__name__, exc_info=(kind, error, traceback))
