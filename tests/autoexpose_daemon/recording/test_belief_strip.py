"""The belief of a replay as a picture, from the command line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from autoexpose_daemon import cli
from tests.autoexpose_daemon.recording.runs import VirtualRun, record

Replay = Callable[..., tuple[int, str, str]]
FIRST, STEPS = 100, 12
"""Triggers of the recording."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a policy without a belief."""
    return record(tmp_path_factory.mktemp("run") / "run.mcap", VirtualRun("neves2009"), STEPS)


@pytest.fixture
def replay(recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Replay:
    """Exit code, and what is printed on stdout and stderr."""

    def call(*options: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["autoexpose", "replay", str(recording), *options])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return int(ended.value.code or 0), *capsys.readouterr()

    return call


def width(path: Path) -> int:
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        assert picture.convert("L").getextrema() == (0, 255)
        return picture.width


def test_the_moments_asked_for_are_drawn_side_by_side(replay: Replay, tmp_path: Path) -> None:
    belief = ("--policy", "belief", "--show-belief")
    code, out, _ = replay(*belief, str(tmp_path / "one.png"), "--at", "105")
    assert (code, out.splitlines()[-1].count("105")) == (0, 1)
    code, out, _ = replay(*belief, str(tmp_path / "two.png"), "--at", "105", "--at", "103")
    assert (code, re.findall(r"\b10\d\b", out.splitlines()[-1])) == (0, ["103", "105"])
    assert width(tmp_path / "two.png") > 1.7 * width(tmp_path / "one.png")


def test_without_a_moment_the_largest_change_is_drawn_and_what_it_led_to(replay: Replay, tmp_path: Path) -> None:
    code, out, _ = replay("--policy", "belief", "--show-belief", str(tmp_path / "strip.png"))
    triggers = [int(number) for number in re.findall(r"\b1\d\d\b", out.splitlines()[-1])]
    assert code == 0
    assert 1 <= len(triggers) <= 4
    assert triggers == sorted(triggers)
    assert set(triggers) <= set(range(FIRST, FIRST + STEPS))
    assert width(tmp_path / "strip.png") > 300


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (("--show-belief", "x.png"), ("neves2009", "--policy belief")),
        (("--policy", "belief", "--show-belief", "x.png", "--at", "999"), ("999",)),
        (("--policy", "belief", "--show-belief", "x.png", *["--at", "105"] * 9), ("--at", "8")),
        (("--policy", "belief", "--show-belief", "nowhere/x.png"), ("nowhere/x.png",)),
        (("--at", "105"), ("--at", "--show-belief")),
    ],
    ids=["no belief", "no such trigger", "too many", "no folder", "nothing to draw"],
)
def test_what_cannot_be_drawn_is_one_sentence(
    replay: Replay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], names: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = replay(*options)
    assert (code, err.count("\n")) == (1, 1)
    assert err.startswith("autoexpose: ")
    assert [name for name in names if name not in err] == []
    assert not list(tmp_path.iterdir())
