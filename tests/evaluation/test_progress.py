"""Lines of progress where there is no terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from evaluation.long_runs import LongProgress


@pytest.mark.parametrize("terminal", [False, True])
def test_a_line_a_minute_where_there_is_no_terminal(terminal: bool) -> None:
    clock_s = [0.0]
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=100)
    progress = LongProgress(console, 3600.0, lambda: clock_s[0])
    bar = progress.add_task("arena", total=100.0)
    for clock_s[0] in (20.0, 40.0, 60.0, 80.0, 100.0, 120.0):
        progress.update(bar, advance=10.0)
    lines = [] if terminal else ["arena: 30 % after 0:01:00, 0:02:20 left", "arena: 60 % after 0:02:00, 0:01:20 left"]
    assert out.getvalue().splitlines() == lines
