"""How the log reads in the journal, and elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence

import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.rig_control import RigControl
from drivers.log_throttle import LogThrottle
from drivers.rig import Rig
from drivers.rig.events import CameraSilent
from tests.drivers.rig.test_rig import ScriptedCamera

ENDING = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()", "run", "-c", "/none.yaml"]
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


def test_the_sentence_that_ends_the_program_has_one_too() -> None:
    (sentence,) = stderr_of(ENDING, journal=True)
    assert sentence.startswith("<3>autoexpose: /none.yaml")


def test_others_get_plain_lines() -> None:
    lines = stderr_of([sys.executable, "-c", PROGRAM], journal=False)
    assert lines[:3] == ["INFO state exposing", "WARNING left camera: gone", r"INFO consumer \x1b[2Jslam"]
    assert lines[3] == "CRITICAL ended by ZeroDivisionError"
    assert lines[-1] == "ZeroDivisionError: died"


def test_an_escape_sequence_reaches_neither_log_nor_terminal() -> None:
    command = [*ENDING[:3], "run", "-c", "/\x1b[2Jnone.yaml"]
    (sentence,) = stderr_of(command, journal=False)
    assert sentence.startswith(r"autoexpose: /\x1b[2Jnone.yaml: ")


def test_what_comes_again_and_again_is_said_seldom() -> None:
    throttle = LogThrottle(10.0)
    said = [second for second in range(35) if throttle.due("left", second * 10**9)]
    assert said == [0, 10, 20, 30]
    assert throttle.due("right", 0)


def test_a_silence_before_every_frame_is_no_line_with_every_frame(caplog: pytest.LogCaptureFixture) -> None:
    config = Config.model_validate({"cameras": {"left": {"serial": "L"}}})
    control = RigControl(config, Rig({"left": ScriptedCamera}, 1.0, config.start))
    for _ in range(5):
        control.take([CameraSilent("left")])
    assert caplog.messages.count("left camera: no frames; checking that it answers") == 1
