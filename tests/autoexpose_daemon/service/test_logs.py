"""How the log reads in the journal, and elsewhere; what the service manager hears."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.rig_control import RigControl
from autoexpose_daemon.service.notify import Notifier
from drivers.log_throttle import LogThrottle
from drivers.rig import Rig
from drivers.rig.events import CameraSilent
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE
from tests.drivers.rig.test_rig import ScriptedCamera
from tests.fakes import unique

PROGRAM = """
import io, logging, threading
from rich.console import Console
from autoexpose_daemon.service.logs import set_up_logging
set_up_logging(Console(file=io.StringIO()))
log = logging.getLogger("autoexpose_daemon.test")
log.info("state exposing")
log.warning("left camera: gone")
log.info("consumer \\x1b[2Jslam")
logging.getLogger("another").info("not ours")
raise ZeroDivisionError("died")
"""


STUCK = """
import io, logging, threading
from rich.console import Console
from autoexpose_daemon.service.logs import set_up_logging
from autoexpose_daemon.status.panel import display
from tests.autoexpose_daemon.status.test_states import degraded
class Terminal(io.StringIO):
    def write(self, text):
        threading.Event().wait()
console = Console(file=Terminal(), force_terminal=True)
set_up_logging(console)
with display(console, str) as show:
    for _ in range(3):
        show(degraded)
        logging.getLogger("autoexpose_daemon.test").warning("left camera: gone")
"""


def stderr_of(command: Sequence[str], journal: bool) -> list[str]:
    reading, writing = os.pipe()
    stream = os.fstat(writing)
    number = stream.st_ino if journal else stream.st_ino + 1  # another stream than the journal's
    environment = os.environ | {"JOURNAL_STREAM": f"{stream.st_dev}:{number}"}
    with os.fdopen(reading) as lines:
        process = subprocess.run(command, stderr=writing, env=environment, check=False)
        os.close(writing)
        assert process.returncode != 0
        return lines.read().splitlines()


def test_the_journal_gets_a_priority_with_every_line() -> None:
    first, second, third, *last_words = stderr_of([sys.executable, "-c", PROGRAM], journal=True)
    assert (first, second, third) == ("<6>state exposing", "<4>left camera: gone", r"<6>consumer \x1b[2Jslam")
    assert last_words[0] == "<2>ended by ZeroDivisionError"
    assert last_words[-1] == "<2>ZeroDivisionError: died"
    assert all(re.match("<2>.", line) for line in last_words)


def test_others_get_plain_lines() -> None:
    lines = stderr_of([sys.executable, "-c", PROGRAM], journal=False)
    assert lines[:3] == ["INFO state exposing", "WARNING left camera: gone", r"INFO consumer \x1b[2Jslam"]
    assert lines[3] == "CRITICAL ended by ZeroDivisionError"
    assert lines[-1] == "ZeroDivisionError: died"


def test_a_terminal_that_takes_nothing_more_delays_nobody_nor_the_end() -> None:
    assert subprocess.run([sys.executable, "-c", STUCK], timeout=60, check=False).returncode == os.EX_IOERR


@pytest.mark.parametrize("journal", [True, False])
def test_the_sentence_that_ends_the_program_is_one_line_without_escapes(journal: bool) -> None:
    (sentence,) = stderr_of([*AUTOEXPOSE, "run", "-c", "/\x1b[2Jnone.yaml"], journal)
    assert sentence.startswith(r"%sautoexpose: /\x1b[2Jnone.yaml: " % ("<3>" if journal else ""))


def test_what_comes_again_and_again_is_said_seldom() -> None:
    throttle = LogThrottle(10.0)
    said = [second for second in range(35) if throttle.due("left", second * 10**9)]
    assert said == [0, 10, 20, 30]
    assert throttle.due("right", 0)


def test_a_silence_before_every_frame_is_no_line_with_every_frame(caplog: pytest.LogCaptureFixture) -> None:
    config = Config.model_validate({"cameras": {"left": {"serial": "L"}}})
    control = RigControl(config, Rig({"left": ScriptedCamera}, 1.0, {"left": config.start}))
    for _ in range(5):
        control.take([CameraSilent("left")])
    assert caplog.messages.count("left camera: no frames; checking that it answers") == 1


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@{unique('notify')}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(address.replace("@", "\0", 1))
        listener.settimeout(5)
        yield listener, address


def test_each_message_is_as_sd_notify_has_it(manager: tuple[socket.socket, str]) -> None:
    listener, address = manager
    notifier = Notifier(address)
    before_us = time.monotonic_ns() // 1000
    notifier.ready()
    notifier.reloading()
    notifier.alive()
    notifier.stopping()
    assert listener.recv(99) == b"READY=1"
    reloading, monotonic = listener.recv(99).split(b"\n")
    assert reloading == b"RELOADING=1"
    assert before_us <= int(monotonic.removeprefix(b"MONOTONIC_USEC=")) <= time.monotonic_ns() // 1000
    assert listener.recv(99) == b"WATCHDOG=1"
    assert listener.recv(99) == b"STOPPING=1"


def test_a_status_is_one_line_of_text_and_is_not_said_twice(manager: tuple[socket.socket, str]) -> None:
    listener, address = manager
    notifier = Notifier(address)
    unnameable = os.fsdecode(b"rig-%s.yaml" % bytes([0xFF]))
    for text in ("exposing", "exposing", "failed:\nno camera", f"failed: {unnameable}"):
        notifier.status(text)
    for said in (b"exposing", b"failed: no camera", rb"failed: rig-\udcff.yaml"):
        assert listener.recv(99) == b"STATUS=" + said


def test_what_this_process_starts_does_not_speak_for_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    notifier = Notifier.from_environment()
    assert "NOTIFY_SOCKET" not in os.environ
    notifier.ready()  # no listener is not an error


def test_a_manager_that_does_not_read_holds_nothing_up(
    manager: tuple[socket.socket, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("autoexpose_daemon.service.notify._PATIENCE_S", 0.001)
    listener, address = manager
    notifier = Notifier(address)
    for _ in range(100):  # far more than a socket's queue holds
        notifier.alive()
    assert listener.recv(99) == b"WATCHDOG=1"
