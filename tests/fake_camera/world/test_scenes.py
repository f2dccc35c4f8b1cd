"""What the cameras see: the furnished room and its file, the path through it, panoramas."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest

from fake_camera.imaging import ImageSettings, ImageSource
from fake_camera.places import Side
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.scene import kept_room as kept
from fake_camera.world.scene.kept_room import kept_room
from fake_camera.world.scene.panorama import DISPARITY_PX, GREY, Panorama, load_radiance
from fake_camera.world.scene.path import BASELINE_M, CameraPath, right_of, turn_right
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.sensor import DEFAULT_F_NUMBER
from fake_camera.world.simulation import RoomView, build_image_source
from tests.data import data

FULL = ImageSettings(2000.0, 0.0, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
STEADY = LightScript((Change(0.0, 150.0),))


SIDES: tuple[Side, ...] = get_args(Side)


class AtRest:
    """A trajectory."""

    def pose(self, time_s: float) -> np.ndarray:
        return np.eye(4)


def wall_ahead() -> Renderer:
    """One that faces a camera at rest."""
    corner, across, down = np.array([-4.0, -4.0, 4.0]), np.array([8.0, 0.0, 0.0]), np.array([0.0, 8.0, 0.0])
    pattern = np.random.default_rng(1).uniform(0.1, 0.9, (64, 64)).astype(np.float32)
    return Renderer([Surface(corner, across, down, pattern)], Pinhole(96, 72, 100.0))


@pytest.fixture(scope="module")
def view() -> RoomView:
    return RoomView(Renderer(furnished_room(1), Pinhole()), CameraPath(), "left")


@pytest.fixture(scope="module")
def sources() -> tuple[ImageSource, ImageSource]:
    return build_image_source("room", "left", STEADY, 1), build_image_source("room", "right", STEADY, 1)


def along_the_path(view: RoomView, lux: float) -> list[np.ndarray]:
    return [view.radiance(np.array([t]), lux).copy() for t in np.arange(0.0, 24.0, 1.5)]


def test_dynamic_range_of_one_turn_exceeds_8_stops_at_any_light(view: RoomView) -> None:
    for lux in (1.0, 150.0):
        radiance = np.concatenate([image[::4, ::4].ravel() for image in along_the_path(view, lux)])
        dark, bright = np.percentile(radiance, [1.0, 99.9])
        assert np.log2(bright / dark) > 8.0


def test_every_direction_is_filled_and_grey_on_average(view: RoomView) -> None:
    for image in along_the_path(view, 1.0):
        assert image.min() > 0.0
        assert 0.03 < np.median(image) < 1.0


def test_every_view_has_corners_to_track(view: RoomView) -> None:
    for image in along_the_path(view, 150.0):
        grey = np.clip(255.0 * (image / np.percentile(image, 95.0)) ** 0.45, 0, 255).astype(np.uint8)
        assert len(cv2.goodFeaturesToTrack(grey, 500, 0.03, 6.0)) > 60


def test_window_keeps_its_daylight_and_the_lamp_follows_the_room(view: RoomView) -> None:
    day, night = along_the_path(view, 150.0), along_the_path(view, 1.0)
    ratios = [d / n for d, n in zip(day, night, strict=True)]
    assert min(ratio.min() for ratio in ratios) == pytest.approx(1.0, abs=1e-3), "the window"
    lamp = max(range(len(night)), key=lambda i: np.where(ratios[i] > 149.0, night[i], 0.0).max())
    assert np.where(ratios[lamp] > 149.0, night[lamp], 0.0).max() > 5.0, "a lamp 5 times as bright as white"


def test_radiance_is_affine_in_the_light(view: RoomView) -> None:
    times = np.array([1.0])
    dark, one, many = (view.radiance(times, lux).copy() for lux in (0.0, 1.0, 150.0))
    np.testing.assert_allclose(many, dark + 150.0 * (one - dark), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("stops", [0.0, 1.0, 3.0])
def test_what_the_sun_shines_on_is_so_many_stops_brighter(stops: float) -> None:
    times = np.array([1.0])
    plain, sunlit = (RoomView(wall_ahead(), AtRest(), "left", sunlit_stops=more) for more in (0.0, stops))
    bright = sunlit.radiance(times, 150.0).copy()
    np.testing.assert_allclose(bright, 2**stops * plain.radiance(times, 150.0), rtol=1e-4)
    bright = sunlit.exposed(1.0, 0.002, 150.0).copy()
    np.testing.assert_allclose(bright, 2**stops * plain.exposed(1.0, 0.002, 150.0), rtol=1e-4)


def test_seeds_make_different_rooms_and_equal_seeds_equal_ones() -> None:
    first, again, other = (furnished_room(seed) for seed in (4, 4, 5))
    assert all(np.array_equal(a.pattern, b.pattern) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].pattern, other[0].pattern)


def test_right_camera_sees_near_things_shifted_left(sources: tuple[ImageSource, ImageSource]) -> None:
    left, right = (source.take(0.5, FULL, 1) for source in sources)
    patch = left[200:340, 360:500]
    scores = cv2.matchTemplate(right[200:340], patch, cv2.TM_CCOEFF_NORMED)[0]
    disparity = 360 - int(np.argmax(scores))
    # 860 px * 80 mm / distance: 0.2 to 3 m.
    assert 860 * 0.08 / 3.2 < disparity < 860 * 0.08 / 0.2


def test_take_is_deterministic(sources: tuple[ImageSource, ImageSource]) -> None:
    source = sources[0]
    moving = replace(FULL, exposure_time_us=7500.0)
    first = source.take(3.3, moving, 9)
    source.take(11.0, moving, 4)
    np.testing.assert_array_equal(source.take(3.3, moving, 9), first)
    rebuilt = build_image_source("room", "left", STEADY, 1)
    np.testing.assert_array_equal(rebuilt.take(3.3, moving, 9), first)
    assert not np.array_equal(source.take(3.3, moving, 10), first)


def test_a_still_camera_sees_the_light_change_and_nothing_else() -> None:
    light = LightScript((Change(0.0, 40.0), Change(5.0, 80.0)))
    source = build_image_source("room", "left", light, 1, still=True)
    at_rest = source.take(0.0, FULL, 9)
    np.testing.assert_array_equal(source.take(3.3, FULL, 9), at_rest)
    assert source.take(6.0, FULL, 9).mean() > 1.2 * at_rest.mean()
    np.testing.assert_array_equal(source.take(3.3, FULL, 9), at_rest)


def test_room_is_well_exposed_by_lamplight_and_in_the_dark() -> None:
    for lux, time_us, gain_db in ((150.0, 2000.0, 0.0), (1.0, 7500.0, 30.0)):
        source = build_image_source("room", "left", LightScript((Change(0.0, lux),)), 1)
        settings = replace(FULL, exposure_time_us=time_us, gain_db=gain_db)
        assert 60 < np.mean([source.take(t, settings, 1).mean() for t in np.arange(0.0, 24.0, 2.0)]) < 140


def wall(seed: int) -> tuple[Surface, ...]:
    numbers = np.random.default_rng(seed)
    corner, edge_u, edge_v = numbers.random((3, 3))
    pattern = numbers.random((5, 7)).astype(np.float32)
    return (
        Surface(corner, edge_u, edge_v, pattern),
        Surface(corner, edge_v, edge_u, pattern[:2, :3], follows_light=False),
    )


@pytest.fixture
def painted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The seeds of the rooms that were painted so far."""
    seeds: list[int] = []

    def paint(seed: int, cleared: bool) -> tuple[Surface, ...]:
        seeds.append(seed)
        return wall(seed + cleared)

    monkeypatch.setattr(kept.room, "furnished_room", paint)
    return seeds


def assert_is(room: tuple[Surface, ...], expected: tuple[Surface, ...]) -> None:
    for one, other in zip(room, expected, strict=True):
        for name in ("corner", "edge_u", "edge_v", "pattern"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert one.pattern.dtype == np.float32
        assert one.follows_light is other.follows_light


def test_the_last_room_is_painted_once(tmp_path: Path, painted: list[int]) -> None:
    for seed in (1, 1, 2, 2, 1):
        assert_is(kept_room(seed, tmp_path / "cache"), wall(seed))
    assert painted == [1, 2, 1]
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_a_cleared_room_is_kept_beside_the_other(tmp_path: Path, painted: list[int]) -> None:
    for cleared in (False, True, False, True):
        assert_is(kept_room(1, tmp_path, cleared), wall(1 + cleared))
    assert painted == [1, 1]


def test_cartons_of_a_cleared_room_stand_at_the_walls() -> None:
    furniture = [furnished_room(4, cleared)[6:31] for cleared in (False, True)]  # five cartons of five sides
    shares = np.linspace(0.0, 1.0, 9)
    nearest_m = [
        min(np.hypot(*(side.corner + share * side.edge_u)[:2]) for side in cartons for share in shares)
        for cartons in furniture
    ]
    assert nearest_m[0] < 1.2
    assert nearest_m[1] > 1.4


def test_a_room_that_other_code_painted_is_painted_again(
    tmp_path: Path, painted: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept_room(1, tmp_path)
    monkeypatch.setattr(kept.cv2, "__version__", "0.1")
    kept_room(1, tmp_path)
    assert painted == [1, 1]


@pytest.mark.parametrize("size", [0, 10, 500])
def test_a_damaged_file_is_painted_again(tmp_path: Path, painted: list[int], size: int) -> None:
    kept_room(1, tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:size])
    assert_is(kept_room(1, tmp_path), wall(1))
    assert painted == [1, 1]


def test_without_a_place_to_keep_it_a_room_is_painted_each_time(tmp_path: Path, painted: list[int]) -> None:
    taken = tmp_path / "file"
    taken.touch()
    for _ in range(2):
        assert_is(kept_room(1, taken / "folder"), wall(1))
    assert painted == [1, 1]


STEP_S = 1 / 240


def speeds(path: CameraPath, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed in m/s and turning rate in deg/s along the path."""
    poses = np.array([path.pose(t) for t in np.arange(0, seconds, STEP_S)])
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / STEP_S
    turns = np.einsum("nji,njk->nik", poses[:-1, :3, :3], poses[1:, :3, :3])
    angles = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
    return speed, np.degrees(angles) / STEP_S


def test_speeds_stay_within_100_mm_and_100_degrees_per_second() -> None:
    speed, rate = speeds(CameraPath(), 52.0)
    assert 0.05 < speed.max() <= 0.1
    assert 40.0 < rate.max() <= 100.0


def test_starts_from_rest_and_has_no_jerks() -> None:
    speed, rate = speeds(CameraPath(), 52.0)
    assert speed[0] < 1e-4
    assert rate[0] < 0.1
    assert np.abs(np.diff(speed)).max() < 2e-3
    assert np.abs(np.diff(rate)).max() < 1.5
    np.testing.assert_array_equal(CameraPath().pose(-3.0), CameraPath().pose(0.0))


def test_is_periodic_once_at_full_speed() -> None:
    path = CameraPath()
    np.testing.assert_allclose(path.pose(5.0), path.pose(5.0 + path.period_s), atol=1e-9)


@pytest.mark.parametrize(
    ("yaw_deg", "right_forward"),
    [(0, ((1, 0), (0, 1))), (90, ((0, -1), (1, 0))), (180, ((-1, 0), (0, -1))), (-90, ((0, 1), (-1, 0)))],
)
def test_a_pair_that_is_turned_looks_there_and_stays_a_pair(
    yaw_deg: float, right_forward: tuple[tuple[int, int], tuple[int, int]]
) -> None:
    """Its axes to the right and forward, by those of the path; the one down stays, and so does the left camera."""
    renderer, path = wall_ahead(), CameraPath()
    left, right = (RoomView(renderer, path, side, yaw_deg) for side in SIDES)
    pose = path.pose(3.0)
    for axis, (x, z) in zip((0, 2), right_forward, strict=True):
        np.testing.assert_allclose(left.pose(3.0)[:, axis], x * pose[:, 0] + z * pose[:, 2], atol=1e-12)
    np.testing.assert_array_equal(left.pose(3.0)[:, (1, 3)], pose[:, (1, 3)])
    np.testing.assert_allclose(right.pose(3.0), right_of(left.pose(3.0)))
    np.testing.assert_allclose(turn_right(yaw_deg) @ turn_right(-yaw_deg), np.eye(4), atol=1e-12)


def test_poses_are_rigid_and_the_right_camera_is_80_mm_along_x() -> None:
    pose = CameraPath().pose(7.7)
    right = right_of(pose)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) > 0
    np.testing.assert_allclose(np.linalg.inv(pose) @ right[:, 3], [BASELINE_M, 0, 0, 1], atol=1e-12)
    np.testing.assert_array_equal(right[:3, :3], pose[:3, :3])


def write_hdr(path: Path, rows: int = 40, columns: int = 80) -> Path:
    """A tiny Radiance file of 12 stops."""
    rng = np.random.default_rng(1)
    coarse = np.exp2(rng.uniform(-6.0, 6.0, (rows // 8, columns // 8, 1))).astype(np.float32)
    assert cv2.imwrite(str(path), np.ascontiguousarray(np.kron(coarse, np.ones((8, 8, 3), np.float32))))
    return path


def test_radiance_is_scaled_to_a_grey_log_mean(tmp_path: Path) -> None:
    radiance = load_radiance(write_hdr(tmp_path / "tiny.hdr"))
    assert radiance.shape == (40, 80)
    assert radiance.dtype == np.float32
    assert np.exp(np.log(radiance).mean()) == pytest.approx(GREY, rel=1e-3)
    assert np.log2(radiance.max() / radiance.min()) > 8.0


def test_hdr_scene_is_a_camera_like_any_other(tmp_path: Path) -> None:
    path = str(write_hdr(tmp_path / "tiny.hdr"))
    left, right = (build_image_source(path, side, STEADY, 3) for side in ("left", "right"))
    first = left.take(2.0, FULL, 5)
    assert first.shape == (540, 720)
    assert 5 < first.mean() < 250
    np.testing.assert_array_equal(left.take(2.0, FULL, 5), first)
    shift = round(DISPARITY_PX)
    difference = right.take(2.0, FULL, 5)[:, : 720 - shift].astype(float) - first[:, shift:]
    assert np.abs(difference).mean() < 4.0, "the right camera sees everything shifted left"


def test_a_slower_lens_needs_a_longer_exposure(tmp_path: Path) -> None:
    path = str(write_hdr(tmp_path / "tiny.hdr"))
    slow = build_image_source(path, "left", STEADY, 3, still=True, lens_f_number=2 * DEFAULT_F_NUMBER)
    usual = build_image_source(path, "left", STEADY, 3, still=True).take(0.0, FULL, 5)
    assert slow.take(0.0, FULL, 5).mean() < 0.7 * usual.mean()
    longer = slow.take(0.0, replace(FULL, exposure_time_us=4 * FULL.exposure_time_us), 5)
    assert np.abs(longer.astype(float) - usual).max() <= 1


def test_pan_starts_from_rest_stays_inside_and_repeats() -> None:
    ramp = np.tile(np.arange(2000, dtype=np.float32), (900, 1))
    pan = Panorama(ramp, "right", 720, 540)
    views = [pan.exposed(t, 0.0, 1.0) for t in np.arange(0.0, 24.0, 1.0)]
    for view in views:
        np.testing.assert_allclose(np.diff(view, axis=1)[:, :-1], 1.0, atol=1e-2)
    np.testing.assert_allclose(pan.exposed(25.0, 0.0, 1.0), views[1], atol=1e-2)
    for start_s, least, most in ((0.0, 0.0, 0.2), (6.0, 1.0, 4.0)):
        moved = pan.exposed(start_s + 1 / 60, 0.0, 1.0) - pan.exposed(start_s, 0.0, 1.0)
        assert least <= moved.mean() < most


def test_an_exposure_is_the_mean_of_its_instants_and_follows_the_light() -> None:
    still = np.random.default_rng(2).random((800, 2100)).astype(np.float32)
    pan = Panorama(still, "left", 720, 540)
    singles = [pan.exposed(6.0 + 0.02 * (part + 0.5) / 3, 0.0, 10.0) for part in range(3)]
    np.testing.assert_allclose(pan.exposed(6.0, 0.02, 10.0), np.mean(singles, axis=0), rtol=1e-4)
    np.testing.assert_allclose(pan.exposed(6.0, 0.02, 20.0), 2.0 * pan.exposed(6.0, 0.02, 10.0), rtol=1e-5)


def test_bad_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty.hdr").write_bytes(b"")
    (tmp_path / "text.hdr").write_text("not a picture")
    (tmp_path / "headless.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n")
    cv2.imwrite(str(tmp_path / "black.hdr"), np.zeros((8, 8, 3), np.float32))
    cases = [
        ("none.hdr", "cannot be read"),
        (".", "cannot be read"),
        ("headless.hdr", "damaged"),
        ("black.hdr", "black"),
    ]
    for name, sentence in [*cases, ("empty.hdr", "not a Radiance picture"), ("text.hdr", "not a Radiance picture")]:
        with pytest.raises(ValueError, match=sentence) as caught:
            build_image_source(str(tmp_path / name), "left", STEADY, 1)
        assert "\n" not in str(caught.value)


@pytest.mark.data
@pytest.mark.parametrize("name", ["hdri_1k_cc0/lobby.hdr", "hdr_stills_bsd/Desk.hdr"])
def test_real_radiance_files(name: str) -> None:
    source = build_image_source(str(data(name)), "left", STEADY, 1)
    images = [source.take(t, FULL, 1) for t in (0.0, 6.0, 12.0)]
    assert all(10 < image.mean() < 200 for image in images)
    assert np.abs(images[0].astype(float) - images[2]).mean() > 3.0
