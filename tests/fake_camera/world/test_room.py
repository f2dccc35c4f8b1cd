"""The furnished room, as linear radiance and as images."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fake_camera.imaging import ImageSettings, ImageSource
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.simulation import RoomView, build_image_source

FULL = ImageSettings(2000.0, 0.0, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
STEADY = LightScript((Change(0.0, 150.0),))


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


def test_longer_exposures_blur_more() -> None:
    """Equal exposure level, so that only the motion during the exposure differs."""
    source = build_image_source("room", "left", LightScript((Change(0.0, 40.0),)), 1)
    fastest_s = 17.0
    gradients = []
    for time_us in (500.0, 2500.0, 7500.0):
        settings = replace(FULL, exposure_time_us=time_us, gain_db=20.0 * np.log10(7500.0 / time_us))
        image = cv2.medianBlur(source.take(fastest_s, settings, 1), 3).astype(np.float32)
        gradients.append(np.percentile(np.abs(cv2.Sobel(image, cv2.CV_32F, 1, 0)), 99.0))
    assert gradients[0] > 1.1 * gradients[2]
    assert gradients[0] > gradients[1] > gradients[2]


def test_room_is_well_exposed_by_lamplight_and_in_the_dark() -> None:
    for lux, time_us, gain_db in ((150.0, 2000.0, 0.0), (1.0, 7500.0, 30.0)):
        source = build_image_source("room", "left", LightScript((Change(0.0, lux),)), 1)
        settings = replace(FULL, exposure_time_us=time_us, gain_db=gain_db)
        assert 60 < np.mean([source.take(t, settings, 1).mean() for t in np.arange(0.0, 24.0, 2.0)]) < 140
