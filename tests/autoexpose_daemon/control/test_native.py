"""The C extension must give the same numbers as numpy and OpenCV, with every instruction set of this processor."""

from __future__ import annotations

import subprocess
import sysconfig
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control import _native
from autoexpose_daemon.control.metrics.gradient import GradientMetric, PackedTables, gradient_weights
from tests import REPOSITORY

from .numpy_pictures import gradient_sum

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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": np.zeros((1, 9), np.uint8)}, "at least 2x2"),
        ({"image": np.zeros((9, 1), np.uint8)}, "at least 2x2"),
        ({"image": np.zeros((9, 9), np.uint16)}, "image must be an array of uint8 with 2"),
        ({"image": np.zeros(9, np.uint8)}, "image must be an array of uint8 with 2"),
        ({"weights": np.zeros(255, np.uint8)}, "256 entries"),
        ({"words": np.zeros((1, 256, 4), np.uint8)}, r"\(n, 256, 8\)"),
        ({"region": np.zeros((9, 8), np.uint8)}, "shape of the image"),
        ({"instruction_set": "sse9"}, "sse9"),
    ],
)
def test_bad_input_is_refused(change: dict[str, object], message: str) -> None:
    good: dict[str, object] = {"image": np.zeros((9, 9), np.uint8), "weights": np.zeros(256, np.uint8)}
    with pytest.raises(ValueError, match=message):
        _native.gradient_sums(**(good | change))


def test_c_compiles_without_warnings() -> None:
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    include = [f"-I{folder}" for folder in (sysconfig.get_paths()["include"], SOURCES)]
    flags = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", *include]
    sources = sorted(str(path) for path in SOURCES.rglob("*.c"))
    checked = subprocess.run([compiler, *flags, *sources], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr
