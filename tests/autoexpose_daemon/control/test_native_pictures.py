"""What the C extension computes of tones, light and exposure times must be what numpy makes of it."""

from __future__ import annotations

import math
import mmap
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control import _native
from autoexpose_daemon.control.metrics.contrast import SensorNoise
from autoexpose_daemon.control.metrics.gradient import ExtremeShares, grey_counts
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.registration import LEAST_SHARE, STRIDE, LightChange, LightRegistration
from imaging.exposure import ExposureLimits
from imaging.response import ResponseFunction

from . import numpy_pictures

LINEAR = ResponseFunction.linear()
NOISE = SensorNoise(10_500.0, 3.0)
SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(2, 41)


def picture(seed: int, height: int, width: int) -> NDArray[np.uint8]:
    """An image of few or many grey levels, as a whole or as a window or transpose of a larger one."""
    rng = np.random.default_rng(seed)
    low, high = np.sort(rng.integers(0, 257, 2))
    larger = rng.integers(low, max(high, low + 1), (height + 3, 2 * width + 1)).astype(np.uint8)
    views = (
        larger[:height, :width].copy(),
        larger[2 : 2 + height, 1 : 1 + width],
        larger[:height, 1::2],
        larger.T.copy().T,
    )
    return views[rng.integers(4)][:height, :width]


def region(seed: int, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed + 1)
    return rng.integers(0, 256, image.shape).astype(np.uint8) * rng.integers(0, 2, image.shape).astype(np.uint8)


def two_look(seed: int, height: int, width: int, weighted: bool) -> tuple[Look, Look]:
    """Two images of a camera: the second is brighter or darker, with noise."""
    rng = np.random.default_rng(seed)
    first = picture(seed, height, width)
    changed = np.rint(first * 2.0 ** rng.uniform(-3, 3) + rng.normal(0, 3, first.shape)).clip(0, 255).astype(np.uint8)
    weights = region(seed, first) if weighted else None
    return Look("left", first, LINEAR, weights), Look("left", changed, LINEAR, weights)


@given(SEEDS, SIZES, st.integers(1, 300), st.booleans())
def test_tones_are_the_same(seed: int, height: int, width: int, weighted: bool) -> None:
    image, response = picture(seed, height, width), ResponseFunction.linear(int(seed % 3) * 20)
    weights = region(seed, image) if weighted else None
    if weights is not None:
        weights[0, 0] = 9  # a region is never empty

    shares = ExtremeShares(response)
    everywhere = np.stack([image >= shares.saturated_from, image <= shares.black_to])
    expected = tuple(np.average(each, weights=weights) for each in everywhere)
    assert shares.measure(image, weights) == pytest.approx(expected, rel=1e-12)
    assert grey_counts(image, weights).tolist() == numpy_pictures.grey_counts(image, weights)


@given(SEEDS, SIZES, st.integers(1, 300), st.integers(-1, 256))
def test_counting_is_counting(seed: int, height: int, width: int, grey: int) -> None:
    image = picture(seed, height, width)
    assert _native.count_at_most(image, grey) == np.count_nonzero(image <= grey)


def test_many_pixels_of_one_grey_level_are_counted() -> None:
    """More than a lane of bytes holds."""
    image = np.full((100, 1000), 7, np.uint8)
    assert _native.count_at_most(image, 7) == image.size
    assert _native.count_at_most(image, 6) == 0


@settings(max_examples=200)
@given(SEEDS, SIZES, SIZES, st.booleans())
def test_changes_of_light_are_the_same(seed: int, height: int, width: int, weighted: bool) -> None:
    first, second = two_look(seed, height, width, weighted)
    registration = LightRegistration({"left": LINEAR})
    assert registration.change(first, 0.0) is None
    before = registration.previous
    assert before is not None
    log_exposure, clipped = registration._tables["left"]
    assert before.tolist() == numpy_pictures.sampled_greys(first.image, int((clipped < 2).sum())).tolist()
    change, now = registration.change(second, 0.0), registration.previous
    assert now is not None
    counts = None if second.weights is None else second.weights[::STRIDE, ::STRIDE]
    counted, known, median = numpy_pictures.light_change(before, now, counts, log_exposure, clipped)
    if math.isnan(median):
        assert change is None
    else:
        assert change == LightChange(median, known >= LEAST_SHARE * counted)


@given(SEEDS, st.sampled_from([1, 2, 3, 200]))
def test_the_median_is_one_of_the_changes(seed: int, count: int) -> None:
    """Of values that differ in any of their bits."""
    rng = np.random.default_rng(seed)
    before, now = rng.integers(0, 256, (2, 1, count)).astype(np.uint8)
    log_exposure = (rng.normal(0, 1, 256) * 10.0 ** rng.integers(-6, 6, 256)).astype(np.float32)
    counted, known, median = _native.light_change(before, now, None, log_exposure, np.ones(256, np.uint8))
    assert counted == known == count
    assert median == np.sort((log_exposure[now] - log_exposure[before]).ravel())[count // 2]


@given(SEEDS, st.floats(0.0, 60.0))
def test_exposure_times_are_the_same(seed: int, motion_px: float) -> None:
    rng = np.random.default_rng(seed)
    limits = ExposureLimits(20.0, float(rng.uniform(100, 20_000)), float(rng.uniform(0, 6)), float(rng.uniform(6, 40)))
    levels = rng.uniform(limits.darkest.level - 1, limits.brightest.level + 1, 40)
    balance = BlurPhotonBalance(NOISE, float(rng.uniform(1, 4)), float(rng.choice([1.0, 4.0])))
    expected = numpy_pictures.exposure_times_us(balance, levels, motion_px, limits)
    assert balance.exposure_times_us(levels, motion_px, limits) == pytest.approx(expected, rel=1e-12)


GREYS, NUMBERS = np.zeros((9, 9), np.uint8), np.zeros(29)
SINGLE = np.zeros(256, np.float32)
FAR = np.broadcast_to(np.zeros((1, 1), np.uint8), (1, 2**62))


def misaligned(count: int) -> Any:
    """So many numbers that begin at an odd address."""
    return memoryview(bytearray(8 * count + 8))[1 : 8 * count + 1].cast("d")


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        ("grey_counts", (GREYS, None, np.zeros(255)), "counts must have 256"),
        ("grey_counts", (GREYS, GREYS[1:], np.zeros(256)), "shape of the image"),
        ("grey_counts", (SINGLE, None, np.zeros(256)), "image must be an array of uint8"),
        ("count_at_most", (GREYS[0], 3), "2 dimension"),
        ("sample_greys", (GREYS, 5, GREYS[0], np.zeros((2, 2), np.uint8)), "saturated 256"),
        ("sample_greys", (GREYS, 0, np.zeros(256, np.uint8), np.zeros((2, 2), np.uint8)), "shape of image"),
        ("sample_greys", (GREYS, 5, np.zeros(256, np.uint8), np.zeros((2, 3), np.uint8)), "shape of image"),
        (
            "sample_greys",
            (FAR, 2**62, np.zeros(256, np.uint8), np.zeros((1, 1), np.uint8)),
            "at most 524288 wide",
        ),
        ("light_change", (GREYS, GREYS[1:], None, SINGLE, np.ones(256, np.uint8)), "alike"),
        ("light_change", (GREYS, GREYS, None, np.zeros(256), np.ones(256, np.uint8)), "type 'f'"),
        ("best_times", (NUMBERS, *[1.0] * 9, NUMBERS[1:]), "times_us must have 29"),
        ("grey_counts", (GREYS, None, misaligned(256)), "counts must be aligned"),
        ("best_times", (misaligned(29), *[1.0] * 9, NUMBERS), "levels must be aligned"),
        ("split_levels", (NUMBERS, NUMBERS[1:], 1.0, 1.0, NUMBERS, NUMBERS), "times_us must have 29"),
    ],
)
def test_bad_input_is_refused(call: str, arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        getattr(_native, call)(*arguments)


def test_counts_whose_product_is_too_great_are_not_none() -> None:
    """2^32 times 2^32 numbers, in memory that is promised and never touched."""
    private, unreserved = 0x02, 0x4000
    with mmap.mmap(-1, 8 << 32, flags=private | unreserved) as memory, memoryview(memory).cast("d") as view:
        many: Any = view
        none = np.zeros(0)
        with pytest.raises(ValueError, match="information must have"):
            _native.weigh_levels(none, None, none, many, many, many, *[1.0] * 4, many, many)


def test_results_are_written_only_where_that_is_allowed() -> None:
    counts = np.zeros(256)
    counts.setflags(write=False)
    with pytest.raises((ValueError, BufferError)):
        _native.grey_counts(GREYS, None, counts)


def test_a_region_between_the_strides_shows_no_change() -> None:
    weights = np.ones((11, 11), np.uint8)
    weights[::STRIDE, ::STRIDE] = 0
    registration = LightRegistration({"left": LINEAR})
    look = Look("left", np.full((11, 11), 90, np.uint8), LINEAR, weights)
    assert registration.change(look, 0.0) is None
    assert registration.change(look, 0.0) is None
    sample = np.zeros((2, 2), np.uint8)
    none = _native.light_change(sample, sample, sample, np.zeros(256, np.float32), np.ones(256, np.uint8))
    assert none[:2] == (0, 0) and math.isnan(none[2])
