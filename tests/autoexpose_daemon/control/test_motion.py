from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.picture.motion import FarnebackMotion, Motion, TileMotion
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction

SIXTIETH_NS = 16_666_667


ALL = pytest.mark.parametrize("flow", [FarnebackMotion, TileMotion])


def view(shift_px: int, gain: float = 1.0, noise: float = 0.0) -> NDArray[np.uint8]:
    """A window into blurred noise, moved by `shift_px`, 720x540, as control sees it."""
    rng = np.random.default_rng(5)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (540, 840)), (0, 0), 12)
    scene = np.asarray(texture, np.float64) / texture.std() * 25 + 70
    frame = scene[:, 20 + shift_px : 740 + shift_px] * gain + np.random.default_rng(6).normal(0, 1, (540, 720)) * noise
    return ImagePreparation().prepare(np.clip(frame, 0, 255).astype(np.uint8)).copy()


def speed(
    flow: type[Motion],
    second: NDArray[np.uint8],
    *,
    stops: float = 0.0,
    interval_ns: int = SIXTIETH_NS,
    first: NDArray[np.uint8] | None = None,
) -> float | None:
    motion = flow(ResponseFunction.linear())
    assert motion.measure(view(0) if first is None else first, 720, 10.0, 0) is None
    return motion.measure(second, 720, 10.0 + stops, interval_ns)


@ALL
@pytest.mark.parametrize("shift_px", [4, 8, 16, 24, 32, 40])
def test_pixels_of_full_resolution_per_sixtieth(flow: type[Motion], shift_px: int) -> None:
    assert speed(flow, view(shift_px)) == pytest.approx(shift_px, rel=0.1)


@ALL
def test_the_true_interval_counts(flow: type[Motion]) -> None:
    assert speed(flow, view(8), interval_ns=2 * SIXTIETH_NS) == pytest.approx(speed(flow, view(8)) / 2)


@ALL
def test_a_still_image_has_no_motion(flow: type[Motion]) -> None:
    assert speed(flow, view(0)) < 0.1


def test_a_change_of_exposure_is_not_motion() -> None:
    compensated, ignored = speed(FarnebackMotion, view(0, 2.0), stops=1.0), speed(FarnebackMotion, view(0, 2.0))
    assert compensated < 0.5
    assert ignored > 2 * compensated


@pytest.mark.parametrize("stops", [0.0, 1.0])
def test_tiles_take_neither_exposure_nor_light_for_motion(stops: float) -> None:
    assert speed(TileMotion, view(0, 2.0), stops=stops) < 0.3
    assert speed(TileMotion, view(24, 2.0), stops=stops) == pytest.approx(24, rel=0.1)


@pytest.mark.parametrize("shift_px", [8, 24, 40])
def test_tiles_see_in_the_dark_what_farneback_misses(shift_px: int) -> None:
    first, second = view(0, 0.06, 1.5), view(shift_px, 0.06, 1.5)
    assert speed(TileMotion, second, first=first) == pytest.approx(shift_px, rel=0.12)
    assert speed(FarnebackMotion, second, first=first) < shift_px / 2


def test_strips_that_are_too_narrow_are_refused() -> None:
    motion = TileMotion(ResponseFunction.linear())
    for _ in range(2):  # from the first frame on, before anything depends on it, and not only then
        with pytest.raises(ConfigurationError, match="90x12 pixels are too narrow"):
            motion.measure(np.zeros((50, 360), np.uint8), 720, 10.0, 0)


@ALL
@pytest.mark.parametrize("interval_ns", [0, -SIXTIETH_NS, 10**9])
def test_no_speed_across_a_gap_or_a_clock_that_went_back(flow: type[Motion], interval_ns: int) -> None:
    assert speed(flow, view(8), interval_ns=interval_ns) is None


def test_another_size_starts_afresh() -> None:
    motion = FarnebackMotion(ResponseFunction.linear())
    motion.measure(view(0), 720, 10.0, 0)
    assert motion.measure(view(8)[:100, :120].copy(), 240, 10.0, SIXTIETH_NS) is None
