"""The policy `belief` in C against the same with numpy: what a scene belief knows after random frames, and plans."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from autoexpose_daemon.control import _native
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, SensorNoise
from autoexpose_daemon.control.picture.motion import PER_US
from autoexpose_daemon.control.picture.steering import STEERING_SHARE
from autoexpose_daemon.control.policies.belief.policy import HOPE, LEAST_CAMERA, Prospects
from autoexpose_daemon.control.policies.belief.scene_belief import HYPOTHESES, RULES, Optics, Outlook, SceneBelief
from autoexpose_daemon.control.snapshot import state_names
from imaging.response import ResponseFunction

from .numpy_belief import NumpyBelief, plan_values, weigh_levels
from .numpy_pictures import sharpness

SEEDS = st.integers(0, 2**32 - 1)
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


SCENE = (*(np.zeros(size) for size in (192, 192, 192, 3, 2, 128, 128, 128)), 0.05)
TABLES = (np.ones(21), np.ones(9), 0, 0.05)
CELLS_WIDE, NONE = np.ones(64), np.ones(0)


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        ("pass_time", (SCENE[:7], 1.0, 0.0, 0), "9"),
        ("pass_time", ((*SCENE[:7], np.zeros(64), 0.05), 1.0, 0.0, 0), "richness must have 128"),
        (
            "see_frame",
            (RULES, SCENE, (np.ones(14), *TABLES[1:]), *[np.ones(128)] * 2, *[1.0] * 3, CELLS_WIDE),
            "3 bins",
        ),
        (
            "see_frame",
            (RULES, SCENE, (*TABLES[:3], 0.0), *[np.ones(192)] * 2, *[1.0] * 3, CELLS_WIDE),
            "3 bins or more",
        ),
        (
            "see_frame",
            (RULES, SCENE, TABLES, np.ones(192), np.ones(190), *[1.0] * 3, CELLS_WIDE),
            "count must have 192",
        ),
        (
            "look_out",
            (RULES, SCENE, TABLES, *[np.ones(2)] * 2, 1.0, 1.0, *[CELLS_WIDE] * 2, None, np.ones(8), None, np.ones(7)),
            "revealed must have 8",
        ),
        ("weigh_levels", (NONE, None, NONE, np.ones(4), np.ones(1), NONE, *[0.1] * 4, NONE, NONE), "at least one"),
        (
            "plan_frames",
            (*[np.ones(4)] * 2, np.ones(3), np.ones(1), *[1.0] * 6, *[np.ones(3)] * 2),
            "shapes of one plan",
        ),
        (
            "plan_frames",
            (*[np.ones(4)] * 2, np.ones(0), np.ones(0), *[1.0] * 6, *[np.ones(4)] * 2),
            "shapes of one plan",
        ),
        ("split_levels", (np.ones(2), np.ones(2), 1.0, 1.0, np.ones(2), np.ones(3)), "sharp must have 2"),
    ],
)
def test_bad_input_is_refused(call: str, arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        getattr(_native, call)(*arguments)
