"""The live view: a panel in a terminal, plain log lines elsewhere."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.live import Live
from rich.panel import Panel

from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import COLOURS, line_of, table_of

log = logging.getLogger(__name__)

_FIRST_LINE_S = 5.0
_LONGEST_PAUSE_S = 3600.0  # a log that is kept for months


Show = Callable[[Callable[[], Status]], None]
"""Takes a function that returns the status; it is called only when the status is shown."""


@contextmanager
def display(console: Console, title: Callable[[], str]) -> Iterator[Show]:
    """A function that shows the status: in a panel in a terminal, else in log lines at growing intervals.

    `title` is called each time the panel is drawn.
    """
    started_s = time.monotonic()
    if console.is_terminal:
        with Live(console=console, auto_refresh=False, transient=False) as live:

            def show(read: Callable[[], Status]) -> None:
                status = read()
                heading = f"{title()}, {time.monotonic() - started_s:.0f} s"
                colour = COLOURS[status.state]
                live.update(Panel(table_of(status), title=heading, expand=False, border_style=colour), refresh=True)

            yield show
    else:
        next_s, pause_s = started_s + _FIRST_LINE_S, _FIRST_LINE_S

        def say(read: Callable[[], Status]) -> None:
            nonlocal next_s, pause_s
            if time.monotonic() >= next_s:
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
                next_s = time.monotonic() + pause_s
                log.info("%s", line_of(read()))

        yield say
