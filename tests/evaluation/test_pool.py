"""Work spread over processes."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time

from evaluation.pool import over_processes


def test_workers_end_with_a_parent_that_is_killed() -> None:
    code = "from tests.evaluation.test_pool import print_worker; print_worker()"
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
