"""Who comes first, in processes of their own: a session's priority is that of all that is in it."""

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


@as_root
@with_sessions
def test_a_service_comes_first_with_its_session() -> None:
    assert said() == [NICENESS, NICENESS, 0, NICENESS]


@as_root
@with_sessions
def test_the_session_of_a_unit_comes_first_though_its_filter_refuses_to_set_a_niceness() -> None:
    """As `SystemCallFilter=~@resources` does; the unit has set it already."""
    refusing = RAISED.replace("found = []", f"found = []\n{REFUSING}")
    assert said("nice", "-n", f"{NICENESS}", script=refusing) == [NICENESS] * 4


@as_root
@with_sessions
def test_a_command_of_a_shell_leaves_the_others_of_its_session_alone() -> None:
    shell = ("sh", "-c", '"$@" && true', "sh")  # leads the session, and stays while the command runs
    assert said(*shell) == [NICENESS, NICENESS, 0, 0]
    assert said(*shell, "nice", "-n", "-15") == [-15, -15, -15, 0]


@as_root
@with_sessions
def test_who_may_not_stays_where_it_is() -> None:
    assert said("setpriv", "--reuid=65534", "--clear-groups", "--inh-caps=-all") == [0, 0, 0, 0]


def test_a_refusal_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "setpriority", refuse)
    come_first()
