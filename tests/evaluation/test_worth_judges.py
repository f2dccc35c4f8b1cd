"""The judges of `worth`: odometry, pairs of frames, and registration."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.arrays import Greys
from evaluation.committed import ROOMS
from evaluation.experiments.teach import replay as teach_replay
from evaluation.experiments.teach.park import Daylight
from evaluation.experiments.worth import odometry_judge, registration_judge
from evaluation.experiments.worth.contenders import APART, CONTENDERS, HAND_TUNED, PUBLISHED
from evaluation.experiments.worth.matches.courses import Eyes, Film, MatchesRig
from evaluation.experiments.worth.matches.judge import (
    LOST_PX,
    PREPARATIONS,
    SeenFrame,
    judged,
    klt_motion,
    orb_motion,
    repeatability,
    seen,
)
from evaluation.experiments.worth.matches.scenes import (
    CANVAS,
    HEIGHT,
    WIDTH,
    MovingStill,
    Rotation,
    Similarity,
    TrueMotion,
    TurningPanorama,
    found_motion,
)
from evaluation.experiments.worth.odometry_judge import (
    CHOICE,
    CLOSEST,
    GROUP,
    JUDGES,
    LUX,
    PERIODS_S,
    SCORED,
    SCREENED_EVERY,
    SEEN,
    WORST_MM,
    RoomDrive,
    RunFollower,
    drives,
    hindsight,
    jobs_of,
    measure_contender,
)
from evaluation.experiments.worth.registration_judge import (
    SCORING,
    TEACHER,
    ParkReplay,
    ReplayLook,
    measure_bounds,
    measure_policies,
    replays,
)
from evaluation.experiments.worth.tables import BOUNDS, FIXED_IN_HINDSIGHT
from evaluation.odometry.tracking import EVERY, FAILED_PAIRS
from evaluation.scenes import stills as pictures
from evaluation.scenes.stills import leaves
from evaluation.scenes.views import CAMERA, WINDOW_AWAY_M
from evaluation.stage.camera import Image
from evaluation.stage.rendering import Stage
from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.shapes import upright
from fake_camera.world.sensor import SensorModel
from imaging.exposure import ExposureSetting
from navigation.views.registration import Vote

DRIVE = RoomDrive(("shelves:1",), 8, "plain", 20.0, "fast", 1.0)
GOOD, BLACK = ExposureSetting(4000.0, 18.0), ExposureSetting(20.0, 0.0)


@pytest.fixture(scope="module", autouse=True)
def one_stage() -> Iterator[Stage]:
    """Built once."""
    stage = DRIVE.stage()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RoomDrive, "stage", lambda _drive: stage)
        yield stage


def test_odometry_gets_frames_with_other_noise_than_policies(one_stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    tracked: list[Image] = []
    follower = {repeat: RunFollower(one_stage, DRIVE, repeat) for repeat in (SEEN, SCORED[0])}
    one_stage.go_to(4)
    for repeat in (SEEN, SCORED[0]):
        odometry = follower[repeat]._odometry["raw"]
        track = odometry.track
        monkeypatch.setattr(odometry, "track", lambda left, right, do=track: (tracked.append(left), do(left, right))[1])
        follower[repeat].look(GOOD)
    taken = one_stage.take(GOOD).frames["left"].grey8()
    assert np.array_equal(tracked[0], taken)
    difference = tracked[1] - taken.astype(np.float64)
    assert abs(difference.mean()) < 0.1 and 0.5 < difference.std() < 20.0
    assert len({CHOICE, SEEN, *SCORED}) == 2 + len(SCORED)


def test_a_run_that_sees_nothing_fails(one_stage: Stage) -> None:
    follower = RunFollower(one_stage, DRIVE, SCORED[0])
    for frame in range(0, (FAILED_PAIRS + 1) * EVERY, EVERY):
        assert {follower.failed(name) for name in PREPARATIONS} == {frame >= FAILED_PAIRS * EVERY}
        one_stage.go_to(frame)
        follower.look(BLACK)
    assert {follower.error_mm(name) for name in PREPARATIONS} == {WORST_MM}


class FakeFollower:
    """Knows which frames it was shown; errs by as many stops as it is off, and fails raw."""

    shown: ClassVar[list[tuple[int, ExposureSetting]]] = []

    def __init__(self, stage: Stage, _drive: RoomDrive, repeat: int) -> None:
        self._stage, self._repeat, self._last = stage, repeat, GOOD
        assert repeat in (CHOICE, *SCORED)

    def look(self, setting: ExposureSetting) -> None:
        self._last = setting
        self.shown.append((self._stage.frame, setting))

    def failed(self, name: str) -> bool:
        return name == "raw"

    def error_mm(self, _name: str) -> float:
        return 1.0 + abs(self._last.level - 14.0) + 10.0 * self._repeat


def test_a_policy_is_scored_on_the_settings_of_the_frames_that_odometry_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(odometry_judge, "RunFollower", FakeFollower)
    monkeypatch.setattr(FakeFollower, "shown", [])
    two = [replace(DRIVE, seconds=20 / 60, seed=seed).plain() for seed in (8, 9)]
    found = measure_contender(drives=two, contender="fixed")
    assert [frame for frame, _ in FakeFollower.shown] == [frame for frame in range(0, 20, EVERY) for _ in SCORED] * 2
    assert all(setting.level == pytest.approx(HAND_TUNED.level) for _, setting in FakeFollower.shown)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert [row["judge"] for row in found] == [*JUDGES] * 2 and len({row["course"] for row in found}) == 2
    assert {row["judge"]: row.get("failed") for row in found} == {
        "odometry-raw": True,
        "odometry-preprocessed": False,
        "odometry-failures": None,
    }
    assert {row["value"] for row in found if row["judge"] == "odometry-failures"} == {0.5}


def test_hindsight_is_chosen_on_one_noise_and_scored_on_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(odometry_judge, "RunFollower", FakeFollower)
    found = {row["judge"]: row for row in hindsight(replace(DRIVE, seconds=0.1))}
    value = found["odometry-raw"]["value"]
    assert found["odometry-raw"]["policy"] == FIXED_IN_HINDSIGHT
    of_noises = [10.0 * repeat + 1.0 for repeat in SCORED]
    assert of_noises[0] <= value < of_noises[-1] + 1.0  # the nearest of levels 1.5 stops apart


def test_odometry_follows_a_real_run() -> None:
    """Two drives of 20 frames, at rest to begin with: no 20 mm yet, but nothing is lost."""
    found = measure_contender(drives=[replace(DRIVE, seconds=0.75).plain()], contender="fixed")
    assert all(not row["failed"] and 0.0 < row["value"] < 10.0 for row in found if "failed" in row)


def test_tuning_and_report_share_neither_picture_nor_room() -> None:
    tuning, report = (drives(name) for name in ("tuning", "report"))
    assert not {one for drive in tuning for one in drive.pictures} & {one for drive in report for one in drive.pictures}
    assert not {drive.seed for drive in tuning} & {drive.seed for drive in report}
    assert min(drive.seed for drive in report) > 2100  # all of earlier reports, and all for tuning, are below
    for each in (tuning, report):
        assert len({drive.name for drive in each}) == len({drive.seed for drive in each}) == len(each) == ROOMS
        assert {(drive.kind, drive.speed) for drive in each} == {(kind, speed) for kind in LUX for speed in PERIODS_S}
        assert 1.0 <= min(drive.lux for drive in each) < 2.0 and 1000.0 < max(drive.lux for drive in each) <= 2000.0


def test_the_window_comes_into_view_within_each_drive() -> None:
    for drive in drives("tuning"):
        if drive.kind == "window":
            there = WINDOW_AWAY_M * np.array([np.cos(drive.bearing_rad), np.sin(drive.bearing_rad), 0.3, 1.0])
            seen = []
            for time_s in np.linspace(0.0, drive.seconds, 60):
                x, _, z, _ = np.linalg.inv(drive.path.pose(time_s)) @ there
                seen.append(z > 0 and abs(x / z) < CAMERA.width / 2 / CAMERA.focal_px)
            assert not seen[0] and any(seen), drive.name


def test_jobs_hold_plain_data_and_a_quick_run_is_short() -> None:
    drive = drives("report")[0]
    assert RoomDrive.of(json.loads(json.dumps(drive.plain()))) == drive
    (given,) = {json.dumps(job.arguments["drives"]) for job in jobs_of("tuning", True)}
    assert [one["seconds"] for one in json.loads(given)] == [1.25]
    full, groups = jobs_of("report", False), ROOMS // GROUP
    screened = 1 + len(CONTENDERS) - len(CLOSEST)  # and the best in hindsight
    assert len(full) == len(CLOSEST) * groups + screened * groups // SCREENED_EVERY
    assert {job.policies for job in full} == {(), *((one.policy_id,) for one in CONTENDERS.values())}


STILL = leaves(np.random.default_rng(5), 1000, 640)
PANORAMA = leaves(np.random.default_rng(6), 1024, 512)


def sharp(view: MovingStill | TurningPanorama, time_s: float) -> Greys:
    """The left image without noise and blur."""
    radiance = view.radiance(time_s)[:, :WIDTH]
    return np.clip(np.rint(250.0 * radiance / np.percentile(radiance, 97)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("view", [MovingStill(STILL, 6.0, 1), TurningPanorama(PANORAMA, 6.0, 1)])
def test_the_known_motion_is_found_in_sharp_images(view: MovingStill | TurningPanorama) -> None:
    """So rendering and truth agree: a wrong sign, centre or time would be pixels."""
    times_s = (0.5, 0.5 + 2 / 60)
    truth = TrueMotion(view.homography(*times_s), view.model)
    first, second = (seen(sharp(view, time_s)) for time_s in times_s)
    found = judged(first, second, truth, sift=True)
    assert found["klt-error-raw"] < 0.05 and found["pose-error-orb-raw"] < 0.2
    assert found["matches-orb-raw"] > 150 and found["matches-sift-raw"] > 100
    assert found["repeatability-orb-raw"] > 0.6
    assert not any(found[judge] for judge in found if judge.startswith("lost"))


def test_an_image_and_itself_agree_in_everything() -> None:
    image = SeenFrame(sharp(MovingStill(STILL, 0.0, 1), 0.0))
    still = TrueMotion(np.eye(3), Similarity())
    assert klt_motion(image, image, still).error_px == pytest.approx(0.0, abs=1e-3)
    assert orb_motion(image, image, still).error_px == pytest.approx(0.0, abs=1e-9)
    assert repeatability(image, image, still) == 1.0


def test_what_shows_nothing_is_lost() -> None:
    black = seen(np.zeros((HEIGHT, WIDTH), np.uint8))
    found = judged(black, black, TrueMotion(np.eye(3), Similarity()), sift=True)
    assert found["matches-orb-raw"] == found["matches-sift-raw"] == found["repeatability-orb-raw"] == 0.0
    assert found["lost-pairs-orb-raw"] == found["lost-pairs-klt-preprocessed"] == 1.0
    assert found["klt-error-raw"] == found["pose-error-orb-preprocessed"] == LOST_PX


@given(st.integers(0, 10_000), st.floats(0.0, 0.5), st.booleans())
def test_ransac_finds_a_motion_among_wrong_matches(seed: int, wrong: float, turns: bool) -> None:
    """Exactly, from exact matches: the wrong ones do not count."""
    rng = np.random.default_rng(seed)
    camera = np.array([[180.0, 0.0, 179.5], [0.0, 180.0, 134.5], [0.0, 0.0, 1.0]])
    if turns:
        yaw = rng.uniform(-0.1, 0.1)
        turn = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
        motion = camera @ turn @ np.linalg.inv(camera)
    else:
        a, b = 1 + rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1)
        motion = np.array([[a, -b, rng.uniform(-20, 20)], [b, a, rng.uniform(-20, 20)], [0.0, 0.0, 1.0]])
    here = rng.uniform((0, 0), (WIDTH, HEIGHT), (100, 2))
    moved = np.column_stack([here, np.ones(100)]) @ motion.T
    there = moved[:, :2] / moved[:, 2:]
    false = rng.random(100) < wrong
    there[false] += rng.uniform(20, 80, (int(false.sum()), 2))
    found = found_motion(Rotation(camera) if turns else Similarity(), here, there, 2.0)
    assert found is not None
    assert found / found[2, 2] == pytest.approx(motion / motion[2, 2], abs=1e-6)


def test_more_noise_brings_fewer_inliers_and_larger_errors_on_average() -> None:
    """Fewer of ORB's matches; of corners there are more in noise, and they are followed less precisely."""
    view = MovingStill(STILL, 3.0, 2)
    means = []
    for read_noise_e in (3.0, 24.0, 96.0):
        film = Film(view, 3.0, lambda _: 1.0)
        rig = MatchesRig(film, Eyes(SensorModel(WIDTH, HEIGHT, read_noise_e=read_noise_e)), 1)
        means.append(np.mean([matches_and_error(film, rig, number) for number in (0, 10, 20)], axis=0))
    matches, errors = np.array(means).T
    assert (np.diff(matches) < 0).all() and (np.diff(errors) > 0).all()


def matches_and_error(film: Film, rig: MatchesRig, number: int) -> tuple[int, float]:
    """Inliers of ORB and error of KLT, in a dim pair."""
    setting = ExposureSetting(2000.0, 30.0)
    images = []
    for each in (number, number + 2):
        film.go_to(each)
        images.append(SeenFrame(rig.expose("left", setting).grey8()))
    truth = film.truth((number, 2000.0), (number + 2, 2000.0))
    return orb_motion(*images, truth).inliers, klt_motion(*images, truth).error_px


def test_exposures_blur_with_their_length_and_keep_the_light() -> None:
    film = Film(MovingStill(STILL, 10.0, 2), 10.0, lambda _: 7.0)
    film.go_to(3)
    short, long = film.radiance(100e-6).copy(), film.radiance(7500e-6).copy()
    assert short.shape == CANVAS[::-1]
    assert long.mean() == pytest.approx(short.mean(), rel=0.02)
    assert np.abs(np.diff(long, axis=1)).mean() < 0.8 * np.abs(np.diff(short, axis=1)).mean()


def test_the_truth_is_that_of_the_middle_of_each_exposure() -> None:
    """A long exposure shows the scene half its length later."""
    film = Film(MovingStill(STILL, 10.0, 2), 10.0, lambda _: 100.0)
    rig = MatchesRig(film, Eyes(), 1)
    film.go_to(0)
    first = SeenFrame(rig.expose("left", ExposureSetting(7500.0, 0.0)).grey8())
    film.go_to(2)
    second = SeenFrame(rig.expose("left", ExposureSetting(1500.0, 14.0)).grey8())
    right = klt_motion(first, second, film.truth((0, 7500.0), (2, 1500.0)))
    wrong = klt_motion(first, second, film.truth((0, 1500.0), (2, 1500.0)))
    assert right.error_px < 0.3 < wrong.error_px


def test_the_state_of_the_right_eye_leaves_the_left_alone() -> None:
    setting = ExposureSetting(2000.0, 6.0)
    pairs: dict[str, Any] = {}
    for right in ("open", "dark", "dirty", "dead"):
        film = Film(MovingStill(STILL, 3.0, 2), 3.0, lambda _: 50.0)
        film.go_to(0)
        pairs[right] = MatchesRig(film, Eyes(right=right), 1).take(setting).frames
    left = pairs["open"]["left"].pixels
    assert all((frames["left"].pixels == left).all() for frames in pairs.values())
    detail = {right: np.abs(np.diff(frames["right"].pixels.astype(int))).mean() for right, frames in pairs.items()}
    assert detail["open"] > 2 * detail["dirty"] and pairs["dark"]["right"].pixels.mean() < 0.1 * left.mean()
    assert pairs["dead"]["right"].pixels.max() <= 3


def test_a_photograph_is_known_by_its_content(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "DATA", tmp_path)
    (tmp_path / "a.hdr").write_bytes(b"one")
    (tmp_path / "b.hdr").write_bytes(b"two")
    assert pictures.digest("a.hdr") != pictures.digest("b.hdr") and pictures.digest("leaves:3") == ""


REPLAY = ParkReplay(0, "clear", "in the upper half", 20, 1)


def clearing(_seed: int, daylight: Daylight) -> list[Surface]:
    """A ring of painted boards instead of a park, which takes seconds to build."""
    blots = cv2.GaussianBlur(np.random.default_rng(3).normal(size=(600, 4800)), (0, 0), 3.0)
    paint = (0.2 * np.exp2(1.5 * blots / blots.std())).astype(np.float32)
    boards = []
    for number, facing in enumerate(np.arange(8) * 45.0):
        angle = math.radians(facing)
        pattern = paint[:, 600 * number : 600 * (number + 1)] * np.float32(daylight.on_upright(facing))
        centre = 10.0 * np.array([math.cos(angle), math.sin(angle)])
        boards.append(upright(centre, float(facing), 8.3, (0.0, 8.0), pattern))
    return boards


def test_everyone_has_all_rows_and_what_is_white_registers_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registration_judge, "_built", clearing)
    monkeypatch.setattr(registration_judge, "STOPS", (0, 8))
    monkeypatch.setattr(teach_replay, "FIRST_FRAMES", 4)
    monkeypatch.setattr(teach_replay, "STILL_FRAMES", 3)
    given: dict[str, Any] = {"replay": REPLAY.plain()}
    found = [*measure_policies(**given, policies=["neves2009"]), *measure_bounds(**given)]
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    expected = {
        *product(registration_judge.JUDGES, ["neves2009"]),
        *product(list(registration_judge.JUDGES)[:2], BOUNDS),
    }
    assert {(row["judge"], row["policy"]) for row in found} == expected and len(found) == len(expected)
    for row in found:
        # 8 stops more than the operator's exposure would register nothing.
        assert row["value"] >= 0.8 if row["judge"].startswith("registration") else 0.0 <= row["value"] < 0.2
    assert registration_judge.CHOICE not in SCORING


def test_only_a_shift_within_5_pixels_is_right() -> None:
    look = ReplayLook(0, np.eye(4), 1.0, 20.0)
    nine = np.ones(9, bool)
    assert [look.found(Vote(shift, nine)) for shift in (15.0, 24.9, 26.0, None)] == [True, True, False, False]
    assert not ReplayLook(0, np.eye(4), 1.0, math.nan).found(Vote(20.0, nine))


class FakeSight:
    """Two maps with two images each; votes are most where image and map have the level that the map likes."""

    maps = 2
    looks = tuple(ReplayLook(index, np.eye(4), 1.0, 0.0) for index in (0, 0, 1, 1))
    liked = (5, 7)

    def vote(self, map_level: int, level: int, place: int) -> Vote:
        off = abs(level - self.liked[self.looks[place].index]) + abs(map_level - level)
        return Vote(0.0 if off < 3 else 99.0, np.ones(100 - 10 * off, bool))

    def foreign_vote(self, level: int, place: int) -> Vote:
        return Vote(0.0, np.ones(100 - abs(level - 4 - place), bool))

    def own(self, maps: Sequence[int], images: Sequence[int]) -> list[Vote]:
        return [self.vote(maps[look.index], images[place], place) for place, look in enumerate(self.looks)]

    def on_foreign(self, images: Sequence[int]) -> list[Vote]:
        return [self.foreign_vote(level, place) for place, level in enumerate(images)]

    def share(self, votes: Sequence[Vote]) -> float:
        return float(np.mean([look.found(vote) for look, vote in zip(self.looks, votes, strict=True)]))


def test_the_best_fixed_exposure_serves_all_images_and_the_oracle_each() -> None:
    sight: Any = FakeSight()
    maps, images, others = registration_judge._fixed(sight, [3, 4, 5, 6, 7, 8])
    assert (maps, images, others) == ([5] * 2, [5] * 4, [5] * 4)  # the first of equals
    maps, images, others = registration_judge._free(sight, [3, 5, 7], [4, 5, 6, 7])
    assert (maps, images, others) == ([5, 7], [5, 5, 7, 7], [4, 5, 6, 7])


def test_tuning_and_report_share_no_park() -> None:
    tuning, report = (replays(name) for name in ("tuning", "report"))
    assert max(one.seed for one in tuning) < 100 <= min(one.seed for one in report)
    for courses in (tuning, report):
        assert len({one.seed for one in courses}) == len({one.name for one in courses}) == len(courses)
        assert {one.light for one in courses} >= {"clear", "overcast"}


def test_every_job_that_meets_the_foreign_map_depends_on_its_teacher() -> None:
    assert TEACHER in {one.policy_id for one in PUBLISHED}
    for quick in (True, False):
        work = registration_judge.jobs_of("report", quick)
        assert all(job.policies is not None and TEACHER in job.policies for job in work)
        assert sum("contender" in job.arguments for job in work) == len(APART) * len(work) // (len(APART) + 2)
