"""Rigs of fake cameras for the tests of others: names, places, and processes that answer."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import pytest

from fake_camera.bench import RunningCamera, camera_rig, client_environment
from fake_camera.bench.nursery import forked
from fake_camera.places import MOST_CAMERAS, PLACES, names_of_rig
from tests.fake_camera.gige.gige_client import DISCOVERY, GvcpClient

FOUR = ["front_left", "front_right", "rear_left", "rear_right"]


@contextmanager
def rig_of(n: int, transport: Literal["gige", "usb3"] = "gige") -> Iterator[dict[str, RunningCamera]]:
    with camera_rig(n, transport=transport, options=["--still"], start=forked) as rig:
        assert len({camera.line0 for camera in rig.values()}) == 1
        assert all(f"({name})" in camera.ready for name, camera in rig.items())
        yield rig


def test_up_to_two_cameras_are_a_stereo_pair_and_more_are_pairs_around_a_robot() -> None:
    assert [names_of_rig(n) for n in (1, 2, 4)] == [["left"], ["left", "right"], FOUR]
    assert [len(names_of_rig(n)) for n in range(1, MOST_CAMERAS + 1)] == list(range(1, MOST_CAMERAS + 1))
    for name in names_of_rig(MOST_CAMERAS):
        assert PLACES[name].side == name.rpartition("_")[2]
    for n in (0, 9):
        with pytest.raises(ValueError, match=f"a rig of {n} cameras: give 1 to 8"):
            names_of_rig(n)


@pytest.mark.wire
def test_each_camera_of_a_rig_answers_a_search() -> None:
    with rig_of(4) as rig:
        assert list(rig) == FOUR
        for camera in rig.values():
            with GvcpClient(camera.address) as client:
                status, answer = client.ask(DISCOVERY)
            assert status == 0 and camera.serial.encode() in answer
    assert len({camera.address for camera in rig.values()}) == len({camera.serial for camera in rig.values()}) == 4


@pytest.mark.wire
@pytest.mark.needs("arv-tool-0.8")
def test_each_camera_of_a_rig_is_on_the_usb_bus() -> None:
    with rig_of(3, "usb3") as rig:
        sockets = [camera.socket for camera in rig.values() if camera.socket is not None]
        seen = subprocess.run(
            ["arv-tool-0.8"], env=client_environment(sockets), capture_output=True, text=True, check=True
        )
    assert all(camera.serial in seen.stdout for camera in rig.values())


SUITE = """
import pytest

def test_a_pair(camera_rig):
    assert list(camera_rig) == ["left", "right"]

@pytest.mark.camera_twin(n=3, options=["--still"])
def test_three(camera_rig):
    assert list(camera_rig) == ["front_left", "front_right", "rear_left"]
"""


@pytest.mark.wire
def test_the_fixture_is_a_stereo_pair_unless_the_marker_says_how_many(tmp_path: Path) -> None:
    (tmp_path / "test_mine.py").write_text(SUITE)
    options = ["-q", "-p", "no:cacheprovider", "-p", "fake_camera.bench.pytest_plugin", "--strict-markers"]
    command = [sys.executable, "-m", "pytest", *options, "test_mine.py"]
    mine = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "2 passed" in mine.stdout, mine.stdout + mine.stderr
