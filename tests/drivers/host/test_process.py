"""Who comes first, and that threads share one heap: asked of processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.host import NICENESS, come_first

RAISED = """
import os, threading
from pathlib import Path
from drivers.host import come_first
found = []
def on_a_thread(run):
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
def look():
    found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
def first():
    come_first()
    look()
    on_a_thread(look)
on_a_thread(first)
look()
print(*found, Path("/proc/self/autogroup").read_text().split()[-1])
"""

REFUSING = """
def refuse(*_): raise PermissionError
os.setpriority = refuse
"""

as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root may raise a priority")
with_sessions = pytest.mark.skipif(
    not Path("/proc/self/autogroup").exists(), reason="this kernel does not group processes by session"
)


def at_first() -> None:
    """Begin at niceness 0: a daemon may have run in this process before."""
    os.setpriority(os.PRIO_PROCESS, 0, 0)


def said(*before: str, script: str = RAISED) -> list[int]:
    """In a session of its own, niceness of the thread that comes first, of one that it starts, of the main thread,
    and of the session."""
    command = [*before, sys.executable, "-c", script]
    process = subprocess.run(
        command, start_new_session=True, preexec_fn=at_first, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    return [int(niceness) for niceness in process.stdout.split()]


SHELL = ("sh", "-c", '"$@" && true', "sh")
"""Leads the session, and stays while the command runs."""
FILTERED = RAISED.replace("found = []", f"found = []\n{REFUSING}")
"""As `SystemCallFilter=~@resources` does in a unit, which has set its niceness already."""
UNPRIVILEGED = ("setpriv", "--reuid=65534", "--clear-groups", "--inh-caps=-all")


@as_root
@with_sessions
@pytest.mark.parametrize(
    ("before", "script", "found"),
    [
        ((), RAISED, [NICENESS, NICENESS, 0, NICENESS]),
        (("nice", "-n", f"{NICENESS}"), FILTERED, [NICENESS] * 4),
        (SHELL, RAISED, [NICENESS, NICENESS, 0, 0]),
        ((*SHELL, "nice", "-n", "-15"), RAISED, [-15, -15, -15, 0]),
        (UNPRIVILEGED, RAISED, [0, 0, 0, 0]),
    ],
    ids=["service", "filtered unit", "shell", "nice already", "unprivileged"],
)
def test_a_service_comes_first_with_its_session_and_a_command_alone(
    before: tuple[str, ...], script: str, found: list[int]
) -> None:
    assert said(*before, script=script) == found


def test_a_refusal_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "setpriority", refuse)
    come_first()


PROGRAM = """
import ctypes, sys, threading
from drivers.host import share_one_heap

if sys.argv[1] == "shared":
    share_one_heap()
c = ctypes.CDLL(None)
c.fopen.restype = c.malloc.restype = ctypes.c_void_p
together = threading.Barrier(4)

def allocate():
    together.wait()
    c.malloc(ctypes.c_size_t(50_000))
    together.wait()

threads = [threading.Thread(target=allocate) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
file = c.fopen(b"/dev/stdout", b"w")
c.malloc_info(0, ctypes.c_void_p(file))
c.fflush(ctypes.c_void_p(file))
"""


def heaps(how: str) -> int:
    said = subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, text=True, check=True, timeout=60)
    return said.stdout.count("<heap nr=")


def test_threads_share_one_heap() -> None:
    assert heaps("as usual") > 1
    assert heaps("shared") == 1


FAULTS = """
import resource, sys
import numpy as np
from drivers.host import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
np.ones(1_000_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    np.ones(1_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(how: str) -> int:
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}  # as Dask sets it
    command = [sys.executable, "-c", FAULTS, how]
    return int(subprocess.run(command, capture_output=True, text=True, check=True, timeout=60, env=environment).stdout)


def test_freed_memory_is_kept_although_the_environment_gives_it_back() -> None:
    assert page_faults("as usual") > 20 * page_faults("kept")
