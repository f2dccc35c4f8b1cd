"""The C extension gives the numbers of numpy and OpenCV, with every instruction set of this processor."""

from __future__ import annotations

import math
import mmap
import subprocess
import sysconfig
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from autoexpose_daemon.control import _native
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, SensorNoise
from autoexpose_daemon.control.metrics.gradient import (
    ExtremeShares,
    GradientMetric,
    PackedTables,
    gradient_weights,
    grey_counts,
    mean_signal,
)
from autoexpose_daemon.control.picture.motion import PER_US
from autoexpose_daemon.control.picture.steering import STEERING_SHARE
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance
from autoexpose_daemon.control.policies.belief.policy import HOPE, LEAST_CAMERA, Prospects
from autoexpose_daemon.control.policies.belief.scene_belief import HYPOTHESES, RULES, Optics, Outlook, SceneBelief
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.registration import LEAST_SHARE, STRIDE, LightChange, LightRegistration
from autoexpose_daemon.control.snapshot import state_names
from imaging.exposure import ExposureLimits
from imaging.response import ResponseFunction
from tests import REPOSITORY

from . import numpy_pictures
from .numpy_belief import NumpyBelief, plan_values, weigh_levels
from .numpy_pictures import gradient_sum, sharpness

SOURCES = REPOSITORY / "autoexpose_daemon" / "control" / "native"
SETS = _native.INSTRUCTION_SETS


def test_it_has_a_portable_set() -> None:
    assert SETS[-1] == "portable"


def random_case(
    seed: int, height: int, width: int, count: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]:
    """Image, tables, weights of magnitudes (some start with zeros), region."""
    rng = np.random.default_rng(seed)
    image = rng.integers(0, rng.choice([2, 40, 256]), (height, width)).astype(np.uint8)
    tables = rng.integers(0, rng.choice([3, 256]), (count, 256)).astype(np.uint8)
    information = rng.integers(0, 256, 256).astype(np.uint8)
    information[: rng.choice([0, 1, 77, 200, 256])] = 0
    region = rng.integers(0, 256, (height, width)).astype(np.uint8)
    return image, tables, information, region


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 40), st.integers(3, 150), st.integers(1, 17), st.booleans())
def test_sums_are_equal(seed: int, height: int, width: int, count: int, with_region: bool) -> None:
    image, tables, information, some_region = random_case(seed, height, width, count)
    region = some_region if with_region else None
    expected = [gradient_sum(table[image], information, region) for table in tables]
    words = PackedTables(tables).words
    for name in SETS:
        assert list(_native.gradient_sums(image, information, words, region, name))[:count] == expected
        assert _native.gradient_sums(tables[0][image], information, None, region, name) == (expected[0],)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_metrics_are_equal_to_the_last_bit(seed: int, with_region: bool) -> None:
    image, tables, _, some_region = random_case(seed, 31, 70, 9)
    region = some_region if with_region else None
    packed = PackedTables(tables)
    weights = gradient_weights()
    full = 255.0 * (image.size if region is None else int(region.sum(dtype=np.int64)))
    expected = [gradient_sum(each, weights, region) / full for each in (image, *(table[image] for table in tables))]
    metric = GradientMetric()
    assert [metric.measure(image, region), *metric.measure_predictions(image, packed, region).tolist()] == expected


@pytest.mark.parametrize("name", SETS)
def test_the_greatest_sums_do_not_overflow(name: str) -> None:
    image = np.tile(np.array([[0, 0, 255, 255]], np.uint8), (300, 150))
    image[::2] = np.roll(image[::2], 1, axis=1)
    all_255, tables = np.full(256, 255, np.uint8), np.tile(np.arange(256, dtype=np.uint8), (8, 1))
    region = np.full(image.shape, 255, np.uint8)
    sums = _native.gradient_sums(image, all_255, PackedTables(tables).words, region, name)
    assert sums == (255 * 255 * image.size,) * 8


def test_windows_and_transposes_need_no_copy() -> None:
    image, tables, information, _ = random_case(1, 40, 60, 8)
    words = PackedTables(tables).words
    for window in (image[3:20, 5:33], image.T, image[::-1, ::2]):
        copied = np.ascontiguousarray(window)
        assert _native.gradient_sums(window, information, words) == _native.gradient_sums(copied, information, words)


def test_threads_do_not_disturb_each_other() -> None:
    image, tables, _, _ = random_case(2, 200, 300, 24)
    packed = PackedTables(tables)
    expected = GradientMetric().measure_predictions(image, packed).tolist()
    found: list[list[float]] = []

    def work() -> None:
        metric = GradientMetric()
        found.extend(metric.measure_predictions(image, packed).tolist() for _ in range(10))

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 30


def test_c_compiles_without_warnings() -> None:
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    include = [f"-I{folder}" for folder in (sysconfig.get_paths()["include"], SOURCES)]
    flags = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", *include]
    sources = sorted(str(path) for path in SOURCES.rglob("*.c"))
    checked = subprocess.run([compiler, *flags, *sources], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr


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
    signal = np.average(image, weights=weights) - response.black_level
    assert mean_signal(image, response, weights) == pytest.approx(signal / (255 - response.black_level))
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


def test_counts_whose_product_is_too_great_are_not_none() -> None:
    """2^32 times 2^32 numbers, in memory that is promised and never touched."""
    private, unreserved = 0x02, 0x4000
    with mmap.mmap(-1, 8 << 32, flags=private | unreserved) as memory, memoryview(memory).cast("d") as view:
        many: Any = view
        none = np.zeros(0)
        with pytest.raises(ValueError, match="information must have"):
            _native.weigh_levels(none, None, none, many, many, many, *[1.0] * 4, many, many)


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


OPTICS = [Optics(ResponseFunction.linear(black), SensorNoise(10_500.0, 3.0)) for black in (0, 9)]
BY_CELL_AND_BIN = ("mass", "energy", "precision")
TINY = 1e-150
"""What has faded to this is nothing to the one, and a number still to the other."""


def random_contrast(rng: np.random.Generator, bins: int) -> Contrast:
    """Gradients of any frame: of few grey levels or many, black, white, or in part of the picture only."""
    low, high = np.sort(rng.integers(0, bins + 1, 2))
    count = np.zeros((CELLS * CELLS, bins))
    count[:, low : max(high, low + 1)] = rng.integers(0, 60, (CELLS * CELLS, max(high, low + 1) - low))
    count *= rng.random(count.shape) < rng.random()
    count[:, 0] += rng.integers(0, 300, CELLS * CELLS) * (rng.random() < 0.4)
    count[:, -1] += rng.integers(0, 300, CELLS * CELLS) * (rng.random() < 0.4)
    count[rng.random(CELLS * CELLS) < 0.1] = 0.0
    return Contrast(count * rng.integers(0, 3000, count.shape) * rng.random() ** 2, count)


def random_light(rng: np.random.Generator) -> NDArray[np.float64] | None:
    return None if rng.random() < 0.5 else np.exp2(-rng.integers(0, 5, CELLS * CELLS) / 4)


@given(SEEDS)
def test_a_scene_belief_knows_and_foretells_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    optics = OPTICS[seed % 2]
    native, oracle = SceneBelief(optics), NumpyBelief(optics)
    level = rng.uniform(2.0, 20.0)
    for _ in range(rng.integers(1, 7)):
        seen, light = random_contrast(rng, optics.bins.count), random_light(rng)
        seconds, moved = rng.choice([0.0, 0.017, 3.0]), rng.choice([0.0, rng.random() * 0.8])
        risen = rng.choice([0.0, rng.normal(0.0, 0.2), rng.uniform(-9.0, 9.0)])
        level = level if rng.random() < 0.5 else rng.uniform(2.0, 20.0)
        gain, averaged = 2.0 ** rng.uniform(0.0, 5.0), float(rng.choice([1.0, 4.0, 16.0]))
        for belief in (native, oracle):
            belief.pass_time(seconds, moved, risen)
            belief.see(seen, level, gain, averaged, light)
    for name in set(state_names(SceneBelief)) - {"latest"}:
        expected = np.transpose(getattr(oracle, name)) if name in BY_CELL_AND_BIN else getattr(oracle, name)
        assert_allclose(getattr(native, name), expected, rtol=1e-9, atol=TINY, err_msg=name)
    levels = np.sort(rng.uniform(0.0, 24.0, 9))
    gains, favours = 2.0 ** rng.uniform(0.0, 5.0, 9), rng.choice([0.0, 0.5, 2.0], CELLS * CELLS)
    one, other = Outlook.of_levels(9), Outlook.of_levels(9)
    native.look_out(levels, gains, favours, one)
    oracle.look_out(levels, gains, favours, other)
    for name, found, expected in zip(Outlook._fields, one, other, strict=True):
        assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=name)


@given(SEEDS, st.integers(1, 9))
def test_levels_are_split_the_same(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    levels, times_us = rng.uniform(0.0, 24.0, count), 2.0 ** rng.uniform(0.0, 14.0, count)
    motion_px, now_us, scale = (
        rng.choice([0.0, rng.uniform(0.0, 80.0)]),
        2.0 ** rng.uniform(0.0, 14.0),
        rng.uniform(1, 8),
    )
    gains, sharp = np.empty((2, count))
    _native.split_levels(levels, times_us, motion_px * PER_US / scale, now_us, gains, sharp)
    assert_allclose(gains, np.exp2(levels) / times_us, rtol=1e-9)
    then, now = (sharpness(motion_px * PER_US * each / scale) for each in (times_us, np.array(now_us)))
    assert_allclose(sharp, np.sqrt(then / now), rtol=1e-9)


@given(SEEDS, st.integers(1, 3), st.integers(1, 12), st.booleans())
def test_levels_are_worth_the_same(seed: int, cameras: int, count: int, steered: bool) -> None:
    rng = np.random.default_rng(seed)
    information, favoured, revealed = rng.random((3, cameras, HYPOTHESES, count)) * rng.choice([0.0, 1e-12, 1.0, 9.0])
    probability, votes = rng.random((cameras, HYPOTHESES)), rng.random(cameras)
    sharp, served = rng.random(count), rng.uniform(1.0, 120.0)
    outlooks = information, favoured if steered else None, revealed, probability
    worth, look = np.empty((2, count))
    _native.weigh_levels(*outlooks, votes, sharp, HOPE, LEAST_CAMERA, STEERING_SHARE, served, worth, look)
    expected = weigh_levels(*outlooks, votes=votes, sharp=sharp, served=served)
    assert_allclose((worth, look), expected, rtol=1e-9, atol=1e-12)


@given(SEEDS, st.integers(2, 30), st.integers(0, 4), st.integers(1, 5), st.integers(1, 9))
def test_plans_promise_the_same(seed: int, planned: int, beyond: int, paths: int, frames: int) -> None:
    rng = np.random.default_rng(seed)
    step, count = rng.uniform(0.1, 0.5), planned + 2 * beyond
    levels = rng.uniform(0.0, 20.0) + step * np.arange(count)
    worth, look = rng.random((2, count))
    light, chances = rng.uniform(-1.0, 1.0, (paths, frames + 1)) * beyond * step, rng.random(paths)
    before = rng.uniform(levels[0] - 1.0, levels[-1] + 1.0)
    prospects = Prospects(levels, step, beyond, worth, look, light, chances / chances.sum(), before)
    assert_allclose(prospects.values(), plan_values(prospects), rtol=1e-9)


GREYS, NUMBERS, NONE = np.zeros((9, 9), np.uint8), np.zeros(29), np.ones(0)
BYTES, SINGLE = np.zeros(256, np.uint8), np.zeros(256, np.float32)
FAR = np.broadcast_to(np.zeros((1, 1), np.uint8), (1, 2**62))
SAMPLE = np.zeros((2, 2), np.uint8)
SCENE = (*(np.zeros(size) for size in (192, 192, 192, 3, 2, 128, 128, 128)), 0.05)
TABLES = (np.ones(21), np.ones(9), 0, 0.05)
CELLS_WIDE = np.ones(64)
SETTING = (1.0, 1.0, 1.0, CELLS_WIDE)
UNFAVOURED = (None, np.ones(8), None, np.ones(7))


def misaligned(count: int) -> Any:
    """So many numbers that begin at an odd address."""
    return memoryview(bytearray(8 * count + 8))[1 : 8 * count + 1].cast("d")


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        ("gradient_sums", (np.zeros((1, 9), np.uint8), BYTES), "at least 2x2"),
        ("gradient_sums", (np.zeros((9, 1), np.uint8), BYTES), "at least 2x2"),
        ("gradient_sums", (np.zeros((9, 9), np.uint16), BYTES), "image must be an array of uint8 with 2"),
        ("gradient_sums", (np.zeros(9, np.uint8), BYTES), "image must be an array of uint8 with 2"),
        ("gradient_sums", (GREYS, BYTES[1:]), "256 entries"),
        ("gradient_sums", (GREYS, BYTES, np.zeros((1, 256, 4), np.uint8)), r"\(n, 256, 8\)"),
        ("gradient_sums", (GREYS, BYTES, None, GREYS[:, 1:]), "shape of the image"),
        ("gradient_sums", (GREYS, BYTES, None, None, "sse9"), "sse9"),
        ("contrast_sums", (GREYS, 0, 252, *np.empty((2, 64, 66))), "each of the 67 bins"),
        ("contrast_sums", (GREYS, 252, 252, *np.empty((2, 64, 66))), "below saturated"),
        ("grey_counts", (GREYS, None, np.zeros(255)), "counts must have 256"),
        ("grey_counts", (GREYS, GREYS[1:], np.zeros(256)), "shape of the image"),
        ("grey_counts", (SINGLE, None, np.zeros(256)), "image must be an array of uint8"),
        ("grey_counts", (GREYS, None, misaligned(256)), "counts must be aligned"),
        ("count_at_most", (GREYS[0], 3), "2 dimension"),
        ("sample_greys", (GREYS, 5, GREYS[0], SAMPLE), "saturated 256"),
        ("sample_greys", (GREYS, 0, BYTES, SAMPLE), "shape of image"),
        ("sample_greys", (GREYS, 5, BYTES, np.zeros((2, 3), np.uint8)), "shape of image"),
        ("sample_greys", (FAR, 2**62, BYTES, np.zeros((1, 1), np.uint8)), "at most 524288 wide"),
        ("light_change", (GREYS, GREYS[1:], None, SINGLE, BYTES), "alike"),
        ("light_change", (GREYS, GREYS, None, np.zeros(256), BYTES), "type 'f'"),
        ("best_times", (NUMBERS, *[1.0] * 9, NUMBERS[1:]), "times_us must have 29"),
        ("best_times", (misaligned(29), *[1.0] * 9, NUMBERS), "levels must be aligned"),
        ("split_levels", (NUMBERS, NUMBERS[1:], 1.0, 1.0, NUMBERS, NUMBERS), "times_us must have 29"),
        ("split_levels", (NUMBERS, NUMBERS, 1.0, 1.0, NUMBERS, NUMBERS[1:]), "sharp must have 29"),
        ("pass_time", (SCENE[:7], 1.0, 0.0, 0), "9"),
        ("pass_time", ((*SCENE[:7], np.zeros(64), 0.05), 1.0, 0.0, 0), "richness must have 128"),
        ("see_frame", (RULES, SCENE, (np.ones(14), *TABLES[1:]), *[np.ones(128)] * 2, *SETTING), "3 bins"),
        ("see_frame", (RULES, SCENE, (*TABLES[:3], 0.0), *[np.ones(192)] * 2, *SETTING), "3 bins or more"),
        ("see_frame", (RULES, SCENE, TABLES, np.ones(192), np.ones(190), *SETTING), "count must have 192"),
        (
            "look_out",
            (RULES, SCENE, TABLES, *[np.ones(2)] * 2, 1.0, 1.0, *[CELLS_WIDE] * 2, *UNFAVOURED),
            "revealed must have 8",
        ),
        ("weigh_levels", (NONE, None, NONE, np.ones(4), np.ones(1), NONE, *[0.1] * 4, NONE, NONE), "at least one"),
        ("plan_frames", (*[np.ones(4)] * 2, np.ones(3), np.ones(1), *[1.0] * 6, *[np.ones(3)] * 2), "of one plan"),
        ("plan_frames", (*[np.ones(4)] * 2, NONE, NONE, *[1.0] * 6, *[np.ones(4)] * 2), "of one plan"),
    ],
)
def test_bad_input_is_refused(call: str, arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        getattr(_native, call)(*arguments)


def test_results_are_written_only_where_that_is_allowed() -> None:
    counts = np.zeros(256)
    counts.setflags(write=False)
    with pytest.raises((ValueError, BufferError)):
        _native.grey_counts(GREYS, None, counts)
