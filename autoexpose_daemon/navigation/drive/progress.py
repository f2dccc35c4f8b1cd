"""One line in the terminal that shows the progress; without a terminal, a line for each change of state."""

from __future__ import annotations

import re
import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from imaging.python310 import Self

_TURN_S = 0.1


class Progress:
    """Shows the progress of a long command, while its context is entered."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._said_s = 0.0
        self._words = ""

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def warn(self, line: str) -> None:
        """Print a line that stays, unless it is empty."""
        if line:
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def say(self, line: str) -> None:
        """Show the progress; lines that differ only in numbers are one state."""
        now_s = time.monotonic()
        if self._live is not None:
            if now_s - self._said_s >= _TURN_S:
                self._said_s = now_s
                self._live.update(Text(line), refresh=True)
            return
        words = re.sub(r"[+-]?[0-9.]+", "", line)
        if words != self._words:
            self._words = words
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)
