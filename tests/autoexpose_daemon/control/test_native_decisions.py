"""What the C extension computes of tones, light, information and levels must be what numpy makes of it."""

from __future__ import annotations

import math
import mmap
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control import _native
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast
from autoexpose_daemon.control.metrics.gradient import ExtremeShares, grey_counts
from autoexpose_daemon.control.metrics.information import InformationPrediction
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance
from autoexpose_daemon.control.policies.metric_map.memory import MetricMemory, Sighting
from autoexpose_daemon.control.policies.metric_map.search import Probes, worth_of_levels
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, MetricView, Tones
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.registration import STRIDE, Registration
from calibration.response import ResponseFunction
from drivers.exposure import ExposureLimits, ExposureSetting

from .scene import LIMITS, radiance, run

LINEAR = ResponseFunction.linear()
NOISE = SensorNoise(10_500.0, 3.0)
SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(2, 41)


USERS = {
    name.rpartition(".")[2]: module
    for name, module in sys.modules.items()
    if name.startswith("autoexpose_daemon.control.")
    and (".belief." not in name or name.endswith(".balance"))
    and hasattr(module, "_native")
}
"""The modules that use the extension and can do without, by name."""


@contextmanager
def numpy_alone(*but: str) -> Iterator[None]:
    """All of them do without it, but for some."""
    with pytest.MonkeyPatch.context() as patch:
        for name in USERS.keys() - set(but):
            patch.setattr(USERS[name], "_native", None)
        yield


def test_all_users_of_the_extension_are_known() -> None:
    """Else tests and benchmark would compare the extension with itself."""
    assert USERS.keys() >= {
        "balance",
        "contrast",
        "gradient",
        "information",
        "memory",
        "policy",
        "registration",
        "search",
    }


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

    def measured() -> tuple[object, ...]:
        look = Look("left", image, response, weights)
        return (
            *Tones(response).measure(look),
            *ExtremeShares(response).measure(image, weights),
            *grey_counts(image, weights),
        )

    native = measured()
    with numpy_alone():
        assert measured() == native


@given(SEEDS, SIZES, st.integers(1, 300), st.integers(-1, 256), st.floats(0.0, 1.0))
def test_counting_is_counting(seed: int, height: int, width: int, grey: int, share: float) -> None:
    image = picture(seed, height, width)
    assert _native.count_at_most(image, grey) == np.count_nonzero(image <= grey)
    rank = share * image.size
    assert _native.grey_of_rank(image, rank) == next(each for each in range(256) if (image <= each).sum() >= rank)


def test_many_pixels_of_one_grey_level_are_counted() -> None:
    """More than a lane of bytes holds."""
    image = np.full((100, 1000), 7, np.uint8)
    assert _native.count_at_most(image, 7) == image.size
    assert _native.count_at_most(image, 6) == 0


@settings(max_examples=200)
@given(SEEDS, SIZES, SIZES, st.booleans())
def test_changes_of_light_are_the_same(seed: int, height: int, width: int, weighted: bool) -> None:
    looks = two_look(seed, height, width, weighted)

    def seen() -> list[object]:
        registration = Registration({"left": LINEAR})
        changes = [registration.change(look, 0.0) for look in looks]
        assert registration.previous is not None
        return [*changes, registration.previous.tolist()]

    native = seen()
    with numpy_alone():
        assert seen() == native


@given(SEEDS, st.sampled_from([1, 2, 3, 200]))
def test_the_median_is_one_of_the_changes(seed: int, count: int) -> None:
    """Of values that differ in any of their bits."""
    rng = np.random.default_rng(seed)
    before, now = rng.integers(0, 256, (2, 1, count)).astype(np.uint8)
    log_exposure = (rng.normal(0, 1, 256) * 10.0 ** rng.integers(-6, 6, 256)).astype(np.float32)
    counted, known, median = _native.light_change(before, now, None, log_exposure, np.ones(256, np.uint8))
    assert counted == known == count
    assert median == np.sort((log_exposure[now] - log_exposure[before]).ravel())[count // 2]


@given(SEEDS, st.booleans(), st.booleans(), st.sampled_from([1.0, 4.0]), st.integers(1, 33))
def test_information_is_the_same(seed: int, with_light: bool, steered: bool, pixels: float, exposures: int) -> None:
    rng = np.random.default_rng(seed)
    deltas = np.sort(rng.uniform(-6, 6, exposures))
    prediction = InformationPrediction(ResponseFunction.linear(int(rng.integers(0, 200))), NOISE, deltas)
    shape = CELLS * CELLS, prediction.bins.count
    count = (
        rng.integers(0, 200, shape) * (rng.random(shape) < 0.4) * (rng.random((shape[0], 1)) < 0.8).astype(np.float64)
    )
    seen = Contrast(count * rng.integers(0, 4000, shape), count)
    light = np.exp2(-rng.integers(0, 5, 64) / 4) if with_light else None
    cell_weights = rng.uniform(0.1, 8, 64) if steered else None
    gain, gains, sharper = float(rng.uniform(1, 30)), rng.uniform(1, 30, exposures), rng.uniform(0.2, 2, exposures)

    def curves() -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        return prediction.curves(seen, pixels, gain, gains, sharper, relative_light=light, cell_weights=cell_weights)

    native = curves()
    with numpy_alone():
        expected = curves()
    assert native[0] == pytest.approx(expected[0], rel=1e-9, abs=1e-12)
    assert (native[1] is None) == (expected[1] is None) == (not steered)
    if native[1] is not None:
        assert native[1] == pytest.approx(expected[1], rel=1e-9, abs=1e-12)


def test_information_of_nothing_is_nothing() -> None:
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    nothing = np.zeros((64, prediction.bins.count))
    assert not prediction.curve(Contrast(nothing, nothing), 4.0, 1.0, np.ones(29), np.ones(29)).any()


@given(SEEDS, st.floats(0.0, 60.0))
def test_exposure_times_are_the_same(seed: int, motion_px: float) -> None:
    rng = np.random.default_rng(seed)
    limits = ExposureLimits(20.0, float(rng.uniform(100, 20_000)), float(rng.uniform(0, 6)), float(rng.uniform(6, 40)))
    balance = BlurPhotonBalance(NOISE, float(rng.uniform(1, 4)), float(rng.choice([1.0, 4.0])))
    levels = rng.uniform(limits.darkest.level - 1, limits.brightest.level + 1, 40)
    native = balance.exposure_times_us(levels, motion_px, limits)
    with numpy_alone():
        assert native == pytest.approx(balance.exposure_times_us(levels, motion_px, limits), rel=1e-12)


def some_memory(rng: np.random.Generator, cameras: int) -> MetricMemory:
    def view() -> MetricView:
        return MetricView(rng.random(DELTAS.size), float(rng.random() * rng.integers(2)), 0.0, 0.5)

    return MetricMemory(
        [
            Sighting(float(rng.uniform(2, 16)), tuple(view() for _ in range(cameras)), float(rng.uniform(0, 4)))
            for _ in range(int(rng.integers(1, 17)))
        ]
    )


@given(SEEDS, st.booleans(), st.integers(1, 2))
def test_sightings_promise_the_same(seed: int, moving: bool, cameras: int) -> None:
    rng = np.random.default_rng(seed)
    memory, levels = some_memory(rng, cameras), np.linspace(4.0, 18.0, 57)
    native = memory.fuse(levels, moving)
    views = rng.random((3, cameras)) * rng.integers(0, 2, (3, cameras))
    places = dict(zip(("frontier", "known_again", "highest"), rng.uniform(3, 19, 3).tolist(), strict=True))
    probes = Probes(*rng.uniform(0.5, 2.0, 3).tolist())
    worth = worth_of_levels(levels, native, views, moving, probes, **places)
    with numpy_alone():
        assert native == pytest.approx(memory.fuse(levels, moving), rel=1e-12)
        assert worth == pytest.approx(worth_of_levels(levels, native, views, moving, probes, **places), rel=1e-12)


@pytest.mark.parametrize("change", [-6.0, 0.0, 6.0])
def test_decisions_are_the_same_but_for_their_last_bits(change: float) -> None:
    """With the same gradients: those that numpy collects are fewer."""

    def decisions() -> list[Decision]:
        found: list[Decision] = []
        start, lights = ExposureSetting(1000.0, 0.0), [11.0 - change / 2] * 8 + [11.0 + change / 2] * 12
        loop = ControlLoop("fisher-map", LINEAR, LIMITS, start)
        run(loop, lights, start, scene=radiance(5, 1.5, (181, 243)), watch=found.append)
        return found

    native = decisions()
    with numpy_alone("contrast", "gradient"):
        for one, other in zip(native, decisions(), strict=True):
            assert one.reason == other.reason
            assert one.setting.agrees_with(other.setting)
            assert one.setting.level == pytest.approx(other.setting.level, abs=1e-9)


GREYS, NUMBERS, NOW = np.zeros((9, 9), np.uint8), np.zeros(29), np.zeros((3, 67))
TABLE, PREDICTED = np.zeros((64, 67)), np.zeros((3, 67, 29))
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
        (
            "predict_information",
            (
                TABLE,
                TABLE[:, 1:].copy(),
                np.zeros((3, 67)),
                PREDICTED,
                4.0,
                1.0,
                *[NUMBERS] * 2,
                None,
                None,
                NUMBERS,
                None,
            ),
            "count must have 4288",
        ),
        (
            "predict_information",
            (TABLE, TABLE, NOW, PREDICTED, 4.0, 1.0, NUMBERS, NUMBERS, NUMBERS, None, NUMBERS, None),
            "relative_light must have 64",
        ),
        (
            "predict_metrics",
            (NUMBERS, *[np.zeros(2)] * 2, np.zeros(3), NUMBERS, NUMBERS, True, NUMBERS, NUMBERS),
            "shape .sightings, cameras",
        ),
        ("grey_counts", (GREYS, None, misaligned(256)), "counts must be aligned"),
        ("best_times", (misaligned(29), *[1.0] * 9, NUMBERS), "levels must be aligned"),
        ("worth_of_levels", (NUMBERS, NUMBERS, np.zeros((3, 2)), True, *[1.0] * 6, NUMBERS), "metrics must have 58"),
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
        one, none = np.zeros(1), np.zeros(0)
        with pytest.raises(ValueError, match="curves must have"):
            _native.predict_metrics(one, one, one, many, none, many, True, many, many)


def test_results_are_written_only_where_that_is_allowed() -> None:
    counts = np.zeros(256)
    counts.setflags(write=False)
    with pytest.raises((ValueError, BufferError)):
        _native.grey_counts(GREYS, None, counts)


def test_a_region_between_the_strides_shows_no_change() -> None:
    weights = np.ones((11, 11), np.uint8)
    weights[::STRIDE, ::STRIDE] = 0
    registration = Registration({"left": LINEAR})
    look = Look("left", np.full((11, 11), 90, np.uint8), LINEAR, weights)
    assert registration.change(look, 0.0) is None
    assert registration.change(look, 0.0) is None
    sample = np.zeros((2, 2), np.uint8)
    none = _native.light_change(sample, sample, sample, np.zeros(256, np.float32), np.ones(256, np.uint8))
    assert none[:2] == (0, 0) and math.isnan(none[2])
