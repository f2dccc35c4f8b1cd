from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.picture.image import CONTROL_SIZE, FLOW_SIZE, ImagePreparation, fit
from drivers.errors import ConfigurationError


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


def test_a_frame_too_small_is_refused_with_its_size() -> None:
    with pytest.raises(ConfigurationError, match="89x68"):
        ImagePreparation().prepare(np.zeros((68, 89), np.uint8))


def test_buffers_are_kept() -> None:
    preparation = ImagePreparation()
    frame = np.zeros((540, 720), np.uint8)
    assert preparation.prepare(frame) is preparation.prepare(frame)
