"""Odometry: its frames, poses, errors and matches, and ORB-SLAM3."""

from __future__ import annotations

import itertools
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from evaluation.arena.race import run_course
from evaluation.arrays import Floats, Greys
from evaluation.experiments.drives import fig12
from evaluation.odometry.features import StereoMatcher, StereoMatches, place
from evaluation.odometry.orb import OrbOdometry, project, refined_pose, rough_pose, transform, triangulate
from evaluation.odometry.orb_slam3 import BRANCHES, LEVELS, TAUGHT_ROOM, OrbSlam3, write_vocabulary
from evaluation.odometry.stereo import StereoCamera, Tracked, images, prepared, relative_errors_mm
from evaluation.odometry.tracking import FAILED_PAIRS, TrackedRun, lap, lost_for_good, odometry_stage, track_entrants
from evaluation.scenes.scenarios import Course
from evaluation.stage.camera import Entrant
from evaluation.stage.rendering import Stage
from fake_camera.world.sensor import DEFAULT_F_NUMBER
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting
from imaging.frames import FrameSet

CAMERA = StereoCamera.simulated()


def moved(turn_rad: tuple[float, float, float], shift_m: tuple[float, float, float]) -> Floats:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(np.array(turn_rad, np.float64))[0], shift_m
    return pose


def cloud(count: int = 200) -> Floats:
    return np.random.default_rng(3).uniform((-0.6, -0.4, 0.7), (0.6, 0.4, 2.5), (count, 3))


def test_points_are_found_again_from_where_both_cameras_see_them() -> None:
    points = cloud()
    assert np.allclose(triangulate(CAMERA, project(CAMERA, points)), points)


def test_the_pose_is_exact_without_noise_and_ignores_outliers() -> None:
    points, motion = cloud(), moved((0.01, 0.03, -0.005), (0.004, -0.001, 0.003))
    seen = project(CAMERA, transform(motion, points))
    seen[:40] += np.random.default_rng(4).uniform(-60, 60, (40, 3))
    seen[100:, 2] = np.nan  # not every point is seen by the right camera
    rough = rough_pose(CAMERA, points, seen[:, :2])
    assert rough is not None
    pose, agree = refined_pose(CAMERA, rough, points, seen, np.ones(len(points)))
    assert np.allclose(pose, motion, atol=5e-5)  # 0.05 mm
    assert agree[40:].all() and agree[:40].sum() <= 2


def test_too_few_points_give_no_pose() -> None:
    points = cloud(5)
    assert rough_pose(CAMERA, points, project(CAMERA, points)[:, :2]) is None


def test_patches_are_placed_to_a_tenth_of_a_pixel_whatever_the_contrast() -> None:
    rng = np.random.default_rng(5)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (200, 200)).astype(np.float32), (0, 0), 2.0)
    texture = (texture - texture.min()) * (200 / np.ptp(texture))
    shift = np.float32([[1, 0, 1.3], [0, 1, -0.6]])
    other = 20 + 0.6 * cv2.warpAffine(texture, shift, (200, 200))
    points = rng.uniform(30, 170, (80, 2))
    placed, good = place(texture.astype(np.uint8), other.astype(np.uint8), points, points, (3, 3))
    assert good.mean() > 0.9
    assert np.median(np.abs(placed - points - (1.3, -0.6))[good]) < 0.1
    _, far = place(texture.astype(np.uint8), other.astype(np.uint8), points, points + 30, (3, 3))
    assert far.mean() < 0.7  # many find their smallest cost at the edge of the search, and say so


def test_flat_images_place_nothing() -> None:
    grey = np.full((60, 60), 80, np.uint8)
    assert not place(grey, grey, np.full((3, 2), 30.0), np.full((3, 2), 30.0), (2, 2))[1].any()
    assert place(grey, grey, np.empty((0, 2)), np.empty((0, 2)), (2, 2))[0].shape == (0, 2)


def test_error_of_a_trajectory_that_is_5_percent_too_long() -> None:
    truth = [moved((0, 0, 0), (0.002 * i, 0, 0)) for i in range(40)]
    estimate = [moved((0, 0, 0), (0.0021 * i, 0, 0)) for i in range(40)]
    errors = relative_errors_mm(truth, estimate)
    assert len(errors) >= 30
    assert np.allclose(errors[:30], 1.0)  # one beginning at each pose with 20 mm of path ahead
    # Where the world's axes are does not matter.
    elsewhere = moved((0.3, -0.2, 1.0), (1, 2, 3))
    assert np.allclose(relative_errors_mm(truth, [elsewhere @ pose for pose in truth]), 0.0, atol=1e-6)


def test_a_run_has_failed_after_some_lost_pairs_in_a_row() -> None:
    almost = [True] * (FAILED_PAIRS - 1) + [False]
    assert not lost_for_good(almost * 3)
    assert lost_for_good([*almost, *[True] * FAILED_PAIRS])


def track(
    stage: Stage, odometry: Any, setting: ExposureSetting, first: int, pairs: int
) -> tuple[list[float], list[bool], Floats]:
    """Errors, lost pairs, and the eighth pose, on part of the lap in good light."""
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    truth, tracked = [], []
    for frame in range(first, first + 2 * pairs, 2):
        stage.go_to(frame)
        tracked.append(odometry.track(*images(stage.take(setting))))
        truth.append(view.pose(stage.start_s(frame) + setting.exposure_time_us / 2e6))
    errors = relative_errors_mm(truth, [one.pose for one in tracked])
    return errors, [one.lost for one in tracked], tracked[7].pose


def test_a_lap_in_good_light_is_followed_and_repeatably() -> None:
    sharp = ExposureSetting(940.0, 24.0)
    stage = odometry_stage("even", 1, 0, 0)
    errors, lost, eighth = track(stage, OrbOdometry(CAMERA), sharp, 60, 22)
    assert not any(lost)
    assert np.mean(errors) < 4.0  # of 20 mm
    assert np.array_equal(track(stage, OrbOdometry(CAMERA), sharp, 60, 15)[2], eighth)


def test_pairs_without_anything_to_see_are_marked_as_lost() -> None:
    odometry = OrbOdometry(CAMERA)
    black = np.zeros((540, 720), np.uint8)
    assert [odometry.track(black, black).lost for _ in range(3)] == [True, True, True]
    assert np.allclose(odometry.track(black, black).pose, np.eye(4))


def test_a_black_pair_is_not_what_later_ones_are_compared_with() -> None:
    stage, black = odometry_stage("even", 1, 0, 0), np.zeros((540, 720), np.uint8)
    odometry = OrbOdometry(CAMERA)
    tied = []
    for number in range(6):
        stage.go_to(60 + 2 * number)
        pair = images(stage.take(ExposureSetting(940.0, 24.0))) if number != 3 else (black, black)
        assert odometry.track(*pair).lost == (number == 3)
        tied.append(len(odometry.inliers_px))
    assert tied[5] > 0.7 * tied[2]


def test_the_lap_starts_from_rest_and_keeps_to_its_speeds() -> None:
    path = lap(0)
    times_s = np.arange(0.0, 12.0, 0.02)
    poses = np.array([path.pose(float(time_s)) for time_s in times_s])
    speeds = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / 0.02
    turns = [np.linalg.norm(cv2.Rodrigues(a[:3, :3].T @ b[:3, :3])[0]) / 0.02 for a, b in itertools.pairwise(poses)]
    assert speeds[0] < 1e-3 and speeds.max() == pytest.approx(0.0855, abs=0.001)
    assert 80 < np.degrees(max(turns)) < 90


SHIFT = 12


def scene(seed: int = 0) -> Greys:
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.integers(20, 230, (34, 52)), np.ones((8, 8)))
    return np.asarray(cv2.GaussianBlur(blocks, (0, 0), 1.0), np.float64).astype(np.uint8)


def views(rows_apart: int = 0) -> tuple[Greys, Greys]:
    whole = scene()
    return whole[4:264, 4:364].copy(), whole[4 + rows_apart : 264 + rows_apart, 4 + SHIFT : 364 + SHIFT].copy()


def slow_matches(left: Greys, right: Greys) -> StereoMatches:
    """Section 3.1's rule with every distance counted bit by bit."""
    orb = cv2.ORB.create(500)
    left_points, left_descriptors = orb.detectAndCompute(left, None)
    right_points, right_descriptors = orb.detectAndCompute(right, None)
    left_bits, right_bits = np.unpackbits(left_descriptors, axis=1), np.unpackbits(right_descriptors, axis=1)
    ratios = []
    for point, bits in zip(left_points, left_bits, strict=True):
        distances = (bits != right_bits).sum(axis=1)
        nearest = int(np.argmin(distances))
        second = int(np.sort(distances)[1])
        if abs(point.pt[1] - right_points[nearest].pt[1]) < 1 and distances[nearest] < 0.7 * second:
            ratios.append(distances[nearest] / second)
    return StereoMatches(len(ratios), float(np.median(ratios)))


def test_matches_equal_the_slow_ones() -> None:
    left, right = views()
    fast, slow = StereoMatcher().match(left, right), slow_matches(left, right)
    assert fast.count == slow.count > 50
    assert fast.median_lowe_ratio == pytest.approx(slow.median_lowe_ratio)


def test_points_on_other_rows_are_no_good_matches() -> None:
    assert StereoMatcher().match(*views(rows_apart=3)).count < 0.1 * StereoMatcher().match(*views()).count


def test_what_has_no_weight_is_not_matched() -> None:
    left, right = views()
    weights = np.zeros_like(left)
    weights[:130] = 255
    assert 0 < StereoMatcher().match(left, right, weights).count < StereoMatcher().match(left, right).count
    assert StereoMatcher().match(left, right, None, np.zeros_like(right)) == StereoMatches(0, None)


def test_nothing_to_see_is_no_match() -> None:
    black = np.zeros((100, 120), np.uint8)
    assert StereoMatcher().match(black, black) == StereoMatches(0, None)


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
    write_vocabulary(np.random.default_rng(0).integers(0, 256, (500, 32), dtype=np.uint8), tmp_path / "vocabulary.txt")
    with closing(OrbSlam3(StereoCamera.simulated(), tmp_path / "vocabulary.txt", tmp_path)) as slam:
        errors, lost, _ = track(odometry_stage("even", 1, 0, 0), slam, ExposureSetting(1880.0, 18.0), 0, 45)
    assert not any(lost)
    assert np.median(errors) < 10.0


START = ExposureSetting(500.0, 20.0)
FIRST_S = 3.0
"""At full speed; the lap begins at rest."""


@pytest.mark.parametrize("delay", [1, 3])
def test_the_arena_judges_the_frame_that_the_policy_saw(delay: int) -> None:
    """Not a frame taken with the setting just decided, which takes effect `delay` frames later."""
    (series,) = run_course("step_down", "leaves", 3, [Entrant.of("begin2022", delay)], frames=38)
    assert np.ptp(series.levels) > 1.0
    assert series.metrics[:, 0] == pytest.approx([decision.metric for decision in series.delayed.decisions])


class Ladder:
    """Decides on a new exposure time at every frame: 1000 us at the first, 1020 us at the second, and so on."""

    def __init__(self, *_setup: object) -> None:
        self.setup = SimpleNamespace(start=START)
        self._seen = 0

    def step(self, _pair: FrameSet) -> SimpleNamespace:
        self._seen += 1
        return SimpleNamespace(setting=ExposureSetting(980.0 + 20.0 * self._seen, 20.0), metric=0.1)


class Nowhere:
    """Odometry that sees nothing."""

    def track(self, _left: Greys, _right: Greys) -> Tracked:
        return Tracked(np.eye(4), lost=True)


def driven(delays: tuple[int, ...], frames: int) -> tuple[Stage, list[TrackedRun], list[list[FrameSet]]]:
    """The stage, the runs of entrants with these delays, and the pairs that odometry got of each."""
    views, light = (stage := odometry_stage("even", 1, 0, 0)).views, stage.light
    times_s = FIRST_S + np.arange(frames) / 60.0
    stage = Stage(views, Course(light, lambda _: 0.0, 0), 0, times_s)
    shown: list[list[FrameSet]] = [[] for _ in delays]
    entrants = [Entrant(f"delay {delay}", delay, Ladder) for delay in delays]
    runs = track_entrants(stage, entrants, Nowhere, frames, lambda entrant, pair: shown[entrant].append(pair))
    return stage, runs, shown


def test_odometry_gets_pairs_taken_with_decisions_of_d_frames_ago_and_the_poses_in_their_middle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("evaluation.odometry.tracking.best_start", lambda _: START)  # slow, and not under test here
    stage, runs, shown = driven((1, 3), 8)
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    for one, pairs in zip(runs, shown, strict=True):
        delay = one.entrant.delay_frames
        assert [pair.frames["left"].frame_id for pair in pairs] == [0, 2, 4, 6]
        for pair, pose in zip(pairs, one.truth, strict=True):
            decided_on = pair.frames["left"].frame_id - delay
            time_us = 500.0 if decided_on < 0 else 1000.0 + 20.0 * decided_on
            assert pair.frames["left"].setting == pair.frames["right"].setting == ExposureSetting(time_us, 20.0)
            middle_s = FIRST_S + pair.frames["left"].frame_id / 60.0 + time_us / 2e6
            assert np.allclose(pose, view.pose(middle_s), atol=1e-6)  # it moves by 1.4 mm in a frame


def test_a_course_behind_half_the_aperture_is_two_stops_darker() -> None:
    usual, slow = (odometry_stage("low", 1, 0, 0, f_number) for f_number in (DEFAULT_F_NUMBER, 2 * DEFAULT_F_NUMBER))
    image = usual.expose("left", ExposureSetting(1000.0, 20.0)).astype(float)
    again = slow.expose("left", ExposureSetting(1000.0, 20.0 + 12.04)).astype(float)
    assert slow.expose("left", ExposureSetting(1000.0, 20.0)).mean() < 0.3 * image.mean()
    assert again.mean() == pytest.approx(image.mean(), rel=0.02)
    assert np.abs(again - image).mean() > 1.0  # with fewer electrons, more noise


def test_odometry_sees_into_the_dark_as_the_paper_does() -> None:
    """With a gamma of 0.3, 1 % of full scale becomes a quarter of it."""
    for grey, seen in ((0, 0), (3, 67), (26, 129), (128, 207), (255, 255)):
        assert np.unique(prepared(np.full((5, 5), grey, np.uint8))).tolist() == [seen]
    hot = np.full((5, 5), 26, np.uint8)
    hot[2, 2] = 255
    assert prepared(hot)[2, 2] == 129
