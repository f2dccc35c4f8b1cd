"""Work spread over processes, and lines of progress where there is no terminal."""

from __future__ import annotations

import io
import os
import select
import subprocess
import sys
import time

import pytest
from rich.console import Console

from evaluation.long_runs import LongProgress
from evaluation.pool import over_processes


def test_workers_end_with_a_parent_that_is_killed() -> None:
    code = "from tests.evaluation.test_long_runs import print_worker; print_worker()"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    try:
        assert select.select([worker], [], [], 60.0)[0]
    finally:
        os.close(worker)


def print_worker() -> None:
    """Print the id of a process that is then busy for longer than any test."""
    for _, number in over_processes(_number_or_sleep, [0, 600, 600], 2):
        print(number, flush=True)


def _number_or_sleep(seconds: int) -> int:
    time.sleep(seconds)
    return os.getpid()


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
