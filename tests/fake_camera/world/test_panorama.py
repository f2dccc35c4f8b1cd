from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.scene.panorama import DISPARITY_PX, GREY, Panorama, load_radiance
from fake_camera.world.sensor import DEFAULT_F_NUMBER
from fake_camera.world.simulation import build_image_source
from tests.data import data

FULL = ImageSettings(2000.0, 0.0, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
LIGHT = LightScript((Change(0.0, 150.0),))


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
    left, right = (build_image_source(path, side, LIGHT, 3) for side in ("left", "right"))
    first = left.take(2.0, FULL, 5)
    assert first.shape == (540, 720)
    assert 5 < first.mean() < 250
    np.testing.assert_array_equal(left.take(2.0, FULL, 5), first)
    shift = round(DISPARITY_PX)
    difference = right.take(2.0, FULL, 5)[:, : 720 - shift].astype(float) - first[:, shift:]
    assert np.abs(difference).mean() < 4.0, "the right camera sees everything shifted left"


def test_a_slower_lens_needs_a_longer_exposure(tmp_path: Path) -> None:
    path = str(write_hdr(tmp_path / "tiny.hdr"))
    slow = build_image_source(path, "left", LIGHT, 3, still=True, lens_f_number=2 * DEFAULT_F_NUMBER)
    usual = build_image_source(path, "left", LIGHT, 3, still=True).take(0.0, FULL, 5)
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
            build_image_source(str(tmp_path / name), "left", LIGHT, 1)
        assert "\n" not in str(caught.value)


@pytest.mark.data
@pytest.mark.parametrize("name", ["hdri_1k_cc0/lobby.hdr", "hdr_stills_bsd/Desk.hdr"])
def test_real_radiance_files(name: str) -> None:
    source = build_image_source(str(data(name)), "left", LIGHT, 1)
    images = [source.take(t, FULL, 1) for t in (0.0, 6.0, 12.0)]
    assert all(10 < image.mean() < 200 for image in images)
    assert np.abs(images[0].astype(float) - images[2]).mean() > 3.0
