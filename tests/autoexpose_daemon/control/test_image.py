from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.picture.image import (
    CONTROL_SIZE,
    FLOW_SIZE,
    ImagePreparation,
    Shrinking,
    fit,
)
from imaging.errors import ConfigurationError


def slow_median(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    padded = np.pad(image, 1, mode="edge")
    height, width = image.shape
    windows = [padded[j : j + height, i : i + width] for j in range(3) for i in range(3)]
    return np.median(windows, axis=0).astype(np.uint8)


def test_half_size_is_the_mean_of_four_then_the_median_of_nine() -> None:
    frame = np.random.default_rng(1).integers(0, 256, (540, 720)).astype(np.uint8)
    quads = frame.reshape(270, 2, 360, 2).sum(axis=(1, 3))
    small = ((quads + 2) // 4).astype(np.uint8)
    prepared = ImagePreparation().prepare(frame)
    assert prepared.shape == (270, 360)
    assert np.array_equal(prepared, slow_median(small))


@pytest.mark.parametrize(
    ("shape", "control", "flow"),
    [
        ((540, 720), (360, 270), (90, 68)),
        ((1080, 1440), (360, 270), (90, 68)),
        ((512, 640), (338, 270), (85, 68)),
        ((600, 1920), (360, 112), (90, 28)),
        ((68, 90), (90, 68), (90, 68)),
    ],
)
def test_the_whole_scene_fits(shape: tuple[int, int], control: tuple[int, int], flow: tuple[int, int]) -> None:
    assert fit(shape, CONTROL_SIZE) == control
    assert fit(shape, FLOW_SIZE) == flow
    assert ImagePreparation().prepare(np.zeros(shape, np.uint8)).shape == control[::-1]


@pytest.mark.parametrize("shape", [(480, 640), (1024, 1280), (1080, 1440), (1200, 1920), (1537, 2049), (2048, 2448)])
def test_any_ratio_is_close_to_an_average_by_area(shape: tuple[int, int]) -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 300, shape), (0, 0), 3.0) * 2 + 120
    frame, size = np.clip(texture, 0, 255).astype(np.uint8), fit(shape, CONTROL_SIZE)
    small = Shrinking(shape, size).shrink(frame)
    averaged = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
    assert small.shape == averaged.shape
    # OpenCV interpolates 0.15 too dark on x86-64, but not on arm64; halving rounds up.
    assert small.mean() == pytest.approx(averaged.mean(), abs=0.5)
    assert small.std() == pytest.approx(averaged.std(), rel=0.07)
    assert np.corrcoef(small.ravel(), averaged.ravel())[0, 1] > 0.98


def test_no_pixel_is_passed_over() -> None:
    frame = np.zeros((1024, 1280), np.uint8)
    frame[:, 1::40] = 255  # lines of one pixel, at all places between the pixels of the small image
    small = Shrinking(frame.shape, fit(frame.shape, CONTROL_SIZE)).shrink(frame)
    assert small.mean() == pytest.approx(frame.mean(), rel=0.05)
    for line in range(1, 1280, 40):
        place = int((line + 0.5) / 1280 * 338)
        assert small[0, max(place - 1, 0) : place + 2].sum() == pytest.approx(255 * 338 / 1280, rel=0.1)


def test_an_image_of_the_size_stays_as_it_is() -> None:
    frame = np.random.default_rng(1).integers(0, 256, (270, 360, 3)).astype(np.uint8)
    assert Shrinking(frame.shape, (360, 270)).shrink(frame) is frame
    assert Shrinking(frame.shape, (90, 68)).shrink(frame).shape == (68, 90, 3)


def test_a_frame_too_small_is_refused_with_its_size() -> None:
    with pytest.raises(ConfigurationError, match="89x68"):
        ImagePreparation().prepare(np.zeros((68, 89), np.uint8))


def test_buffers_are_kept() -> None:
    preparation = ImagePreparation()
    frame = np.zeros((540, 720), np.uint8)
    assert preparation.prepare(frame) is preparation.prepare(frame)
