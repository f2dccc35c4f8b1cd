"""ORB-SLAM3's vocabulary, what the report says without ORB-SLAM3, and ORB-SLAM3 itself where it is installed."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from evaluation.experiments.drives import fig12
from evaluation.odometry.orb_slam3 import BRANCHES, LEVELS, TAUGHT_ROOM, OrbSlam3, write_vocabulary
from evaluation.odometry.stereo import StereoCamera, images, relative_errors_mm
from evaluation.odometry.tracking import odometry_stage
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting


def test_a_vocabulary_is_a_tree_whose_words_are_near_its_descriptors(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    kinds = rng.integers(0, 256, (50, 32), dtype=np.uint8)
    seen = kinds[rng.integers(0, 50, 3000)] ^ (1 << rng.integers(0, 64, (3000, 32))).astype(np.uint8)
    file = tmp_path / "vocabulary.txt"
    nodes = write_vocabulary(seen, file)
    first, *lines = file.read_text(encoding="ascii").split("\n")
    assert first == f"{BRANCHES} {LEVELS} 0 0"
    assert len(lines) == nodes
    parents = [int(line.split()[0]) for line in lines]
    is_word = [line.split()[1] == "1" for line in lines]
    assert all(parent <= number for number, parent in enumerate(parents))
    assert max(np.bincount(parents)) <= BRANCHES
    assert not any(is_word[parent - 1] for parent in parents if parent)
    words = np.array([line.split()[2:34] for line, word in zip(lines, is_word, strict=True) if word], np.uint8)
    away = np.bitwise_count(words[:, None] ^ kinds[None]).sum(axis=2).min(axis=0)
    assert away.max() < 32  # of 256 bits; random ones are 128 apart


def test_without_it_the_report_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fig12, "installed", lambda: False)
    assert fig12.slam_jobs(quick=False) == []
    section = fig12.slam_section([], tmp_path)
    assert "not installed" in section.setting
    assert not section.parts


def test_no_room_is_the_one_that_its_vocabulary_is_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fig12, "installed", lambda: True)
    monkeypatch.setattr(fig12, "version", lambda _package: "1")
    for quick in (True, False):
        assert TAUGHT_ROOM not in {job.arguments["room"] for job in fig12.slam_jobs(quick)}


@pytest.mark.orbslam3
def test_it_follows_a_camera(tmp_path: Path) -> None:
    assert fig12.installed(), "orbslam3-python is not installed"
    stage = odometry_stage("even", 1, 0, 0)
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    write_vocabulary(np.random.default_rng(0).integers(0, 256, (500, 32), dtype=np.uint8), tmp_path / "vocabulary.txt")
    truth, found = [], []
    with closing(OrbSlam3(StereoCamera.simulated(), tmp_path / "vocabulary.txt", tmp_path)) as slam:
        for frame in range(0, 90, 2):
            stage.go_to(frame)
            found.append(slam.track(*images(stage.take(ExposureSetting(1880.0, 18.0)))))
            truth.append(view.pose(stage.start_s(frame) + 0.94e-3))
    assert not any(one.lost for one in found)
    assert np.median(relative_errors_mm(truth, [one.pose for one in found])) < 10.0
