"""`autoexpose record` on fake cameras in real time, and `autoexpose replay` with its picture of the belief."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from autoexpose_daemon.recording.file import LoopState, Setup, Step
from autoexpose_daemon.recording.read import Recording
from autoexpose_daemon.recording.replay import report_replay
from tests.autoexpose_daemon.publish.steps import wait_until
from tests.autoexpose_daemon.recording.runs import VirtualRun, record
from tests.autoexpose_daemon.service.service_process import Within, running_service
from tests.autoexpose_daemon.stereo import stereo_cameras


@pytest.mark.realtime
def test_the_last_second_is_written_on_a_signal_and_at_the_end_and_replayed_bit_for_bit(tmp_path: Path) -> None:
    command = ["record", str(tmp_path / "last.mcap"), "--last", "1"]
    file = tmp_path / "rig.yaml"
    with stereo_cameras("--still") as (left, right, _):
        file.write_text(f"cameras: {{left: {{serial: {left.serial}}}, right: {{serial: {right.serial}}}}}")
        with running_service(file, command=command) as daemon:
            daemon.wait_for("READY=1")
            daemon.process.send_signal(signal.SIGUSR1)
            wait_until((tmp_path / "last-1.mcap").exists, "the file")
    files = sorted(tmp_path.glob("*.mcap"))
    assert [file.name for file in files] == ["last-1.mcap", "last-2.mcap"]
    for file in files:
        assert [type(item) for item in list(Recording(file))[:3]] == [Setup, Step, LoopState]
    said: list[str] = []
    assert report_replay(files[1], None, said.append), said
    assert re.search(r"replayed: (\d+), of which \1 are bit for bit as recorded", "\n".join(said))


def test_a_policy_that_is_no_longer_here_names_the_one_in_its_place(within: Within, tmp_path: Path) -> None:
    told = within.refused("replay", str(tmp_path / "run.mcap"), "--policy", "fisher-map")
    assert "no policy 'fisher-map'; belief took the place of fisher-map;" in told


@pytest.mark.parametrize("last", [(), ("--last", "5")])
def test_a_file_that_is_not_named_as_a_recording_is_refused_at_once(
    within: Within, tmp_path: Path, last: tuple[str, ...]
) -> None:
    config, path = tmp_path / "rig.yaml", tmp_path / "x.txt"
    config.write_text("cameras: {left: {serial: A}}")
    assert f"{path}: is not a name for a recording" in within.refused("record", str(path), "-c", str(config), *last)


Replay = Callable[..., tuple[int, str, str]]
FIRST, STEPS = 100, 12
"""Triggers of the recording."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a policy without a belief."""
    return record(tmp_path_factory.mktemp("run") / "run.mcap", VirtualRun("neves2009"), STEPS)


@pytest.fixture
def replay(recording: Path, within: Within) -> Replay:
    """Exit code, and what is printed on stdout and stderr."""
    return lambda *options: within("replay", str(recording), *options)


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
    said = out.splitlines()[-1].replace(str(tmp_path), "")
    triggers = [int(number) for number in re.findall(r"\b1\d\d\b", said)]
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
