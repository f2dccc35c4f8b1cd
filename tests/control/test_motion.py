from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.image import ImagePreparation
from autoexpose_daemon.control.motion import FarnebackMotion
from calibration.response import ResponseFunction

SIXTIETH_NS = 16_666_667


def view(shift_px: int, gain: float = 1.0) -> NDArray[np.uint8]:
    """A window into blurred noise, moved by `shift_px`, 720x540, as control sees it."""
    rng = np.random.default_rng(5)
    noise = cv2.GaussianBlur(rng.normal(0, 1, (540, 800)), (0, 0), 12)
    scene = np.asarray(noise, np.float64) / noise.std() * 25 + 70
    frame = np.clip(scene[:, 20 + shift_px : 740 + shift_px] * gain, 0, 255).astype(np.uint8)
    return ImagePreparation().prepare(frame).copy()


def speed(second: NDArray[np.uint8], *, stops: float = 0.0, interval_ns: int = SIXTIETH_NS) -> float:
    motion = FarnebackMotion(ResponseFunction.linear())
    assert motion.measure(view(0), 720, 10.0, 0) == 0
    return motion.measure(second, 720, 10.0 + stops, interval_ns)


def test_pixels_of_full_resolution_per_sixtieth() -> None:
    assert speed(view(8)) == pytest.approx(8, rel=0.2)


def test_the_true_interval_counts() -> None:
    assert speed(view(8), interval_ns=2 * SIXTIETH_NS) == pytest.approx(speed(view(8)) / 2)


def test_rest_is_rest() -> None:
    assert speed(view(0)) < 0.1


def test_a_change_of_exposure_is_not_motion() -> None:
    compensated, ignored = speed(view(0, 2.0), stops=1.0), speed(view(0, 2.0))
    assert compensated < 0.3
    assert ignored > 3 * compensated


@pytest.mark.parametrize("interval_ns", [0, -SIXTIETH_NS, 10**9])
def test_no_speed_across_a_gap_or_a_clock_that_went_back(interval_ns: int) -> None:
    assert speed(view(8), interval_ns=interval_ns) == 0


def test_another_size_starts_anew() -> None:
    motion = FarnebackMotion(ResponseFunction.linear())
    motion.measure(view(0), 720, 10.0, 0)
    assert motion.measure(view(8)[:100, :120].copy(), 240, 10.0, SIXTIETH_NS) == 0
