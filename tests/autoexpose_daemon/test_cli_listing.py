"""Listing commands loads none of them; the one that is asked for is loaded whole, or says what it needs."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from autoexpose_daemon.cli import whole_command_line
from autoexpose_daemon.cli.listing import LISTINGS
from tests.autoexpose_daemon.test_cli import Within, within

__all__ = ["within"]

HEAVY = ("numpy", "cv2", "scipy", "matplotlib", "pydantic", "yaml", "importlib.metadata")
PROGRAM = f"""
import atexit, sys
atexit.register(lambda: print("heavy:", *[name for name in {HEAVY} if name in sys.modules]))
sys.argv[0] = "autoexpose"
from autoexpose_daemon.cli import main
main()
"""
LAB = sorted(name for name, listing in LISTINGS.items() if not listing.place)


def said(*arguments: str, **environment: str) -> list[str]:
    """Lines of stdout; of a process, as this one has loaded everything."""
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments],
        env=os.environ | {"COLUMNS": "80"} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stderr == ""
    return result.stdout.splitlines()


def test_the_help_has_a_line_for_each_command_and_loads_none() -> None:
    *lines, heavy = said("--help")
    assert heavy == "heavy:"
    for name, listing in LISTINGS.items():
        assert [line.strip("│ ").split("  ", 1)[1].strip() for line in lines if line.startswith(f"│ {name} ")] == [
            listing.summary
        ]


@pytest.mark.parametrize("words", ["", "a"])
def test_a_shell_completes_names_and_loads_none(words: str) -> None:
    *names, heavy = said(_AUTOEXPOSE_COMPLETE="complete_bash", COMP_WORDS=f"autoexpose {words}", COMP_CWORD="1")
    assert heavy == "heavy:"
    assert names == [name for name in LISTINGS if name.startswith(words)]


def test_a_shell_completes_the_options_of_a_command() -> None:
    *options, _ = said(_AUTOEXPOSE_COMPLETE="complete_bash", COMP_WORDS="autoexpose record --", COMP_CWORD="2")
    assert {"--config", "--bracket", "--keep", "--help"} <= {*options}


def test_every_command_can_be_loaded_and_explains_itself() -> None:
    commands = whole_command_line().commands
    assert commands.keys() == LISTINGS.keys()
    assert [name for name, command in commands.items() if not command.help] == []


@pytest.fixture
def without_the_lab(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: ())
    monkeypatch.setattr("autoexpose_daemon.demo.run.entry_points", lambda **_: ())


@pytest.mark.usefixtures("without_the_lab")
@pytest.mark.parametrize("words", [*([name] for name in LAB), ["map", "--help"], ["demo", "--navigate"]])
def test_without_the_lab_its_commands_say_what_to_install(within: Within, words: list[str]) -> None:
    code, output, told = within(*words)
    assert code == 1
    assert output == ""
    assert "pip install autoexpose-lab" in told
    assert told.count("\n") == 1


@pytest.mark.usefixtures("without_the_lab")
def test_without_the_lab_a_shell_completes_nothing_of_its_commands(
    monkeypatch: pytest.MonkeyPatch, within: Within
) -> None:
    for name, value in (
        ("_AUTOEXPOSE_COMPLETE", "complete_bash"),
        ("COMP_WORDS", "autoexpose map i"),
        ("COMP_CWORD", "2"),
    ):
        monkeypatch.setenv(name, value)
    assert within() == (0, "\n", "")


def test_an_extra_that_is_missing_is_named(within: Within, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.startswith("autoexpose_daemon.client")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "zenoh", None)
    code, _, told = within("ctl", "show")
    assert code == 1
    assert "`autoexpose ctl` needs zenoh" in told
    assert "'autoexpose-daemon[publish]'" in told
