"""Which cameras have a vote, frame by frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.metric_map.search import LONGEST_PROBE
from autoexpose_daemon.control.policies.metric_map.votes import (
    GLARE_FRAMES,
    REPEATS,
    RETURN_FRAMES,
    UNHEARD_FRAMES,
    Votes,
)
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.snapshot import restore, take
from calibration.response import ResponseFunction
from drivers.frames import SIDES, Side

from .scene import radiance

LINEAR = ResponseFunction.linear()
SHAPE = (136, 180)
SCENE = radiance(1, 1.0, SHAPE)
LOWEST = 4.0
BEST = 11.0

Picture = Callable[[float], NDArray[np.uint8]]
"""The image that a camera takes at a level."""


FRESH_NOISE = np.random.default_rng(0)


def healthy(level: float, light: float = BEST, seed: int | None = None) -> NDArray[np.uint8]:
    """With new noise in every frame, or that of a seed."""
    grey = SCENE * 127.5 * 2.0 ** (level - light)
    noise = (FRESH_NOISE if seed is None else np.random.default_rng(seed)).normal(0.0, 0.7, grey.shape)
    return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


def black(level: float) -> NDArray[np.uint8]:
    return np.zeros(SHAPE, np.uint8)


def white(level: float) -> NDArray[np.uint8]:
    return np.full(SHAPE, 255, np.uint8)


def frozen(level: float) -> NDArray[np.uint8]:
    return healthy(BEST - 1.0, seed=9)


def noisy_black(level: float) -> NDArray[np.uint8]:
    noise = np.random.default_rng(round(level * 1000)).normal(0.0, 1.5, SHAPE)
    return np.clip(np.rint(noise), 0, 255).astype(np.uint8)


def darker(level: float) -> NDArray[np.uint8]:
    """Behind a filter of 8 stops."""
    return healthy(level, BEST + 8.0)


def votes_after(levels: list[float], pictures: dict[Side, Picture], votes: Votes | None = None) -> Votes:
    votes = votes or Votes(dict.fromkeys(SIDES, LINEAR))
    for level in levels:
        votes.see(level, LOWEST, [Look(side, picture(level), LINEAR) for side, picture in pictures.items()])
    return votes


def pair(faulty: Picture, side: Side) -> dict[Side, Picture]:
    return {each: faulty if each == side else healthy for each in SIDES}


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("picture", [black, noisy_black, darker])
def test_a_camera_that_is_black_where_the_other_sees_well_has_no_vote(picture: Picture, side: Side) -> None:
    votes = votes_after([BEST] * 2, pair(picture, side))
    assert votes.faults == {side: "black"}
    assert votes.remark() == f"; {side} camera shows nothing, not counted"


@pytest.mark.parametrize("side", SIDES)
def test_a_white_camera_loses_its_vote_at_the_lowest_exposure_only(side: Side) -> None:
    """Above it may be a legitimate picture, only too bright."""
    votes = votes_after([BEST, BEST - 2.0, BEST - 5.0], pair(white, side))
    assert votes.faults == {}
    assert votes_after([LOWEST] * 2, pair(white, side), votes).faults == {side: "white"}


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("step", [0.12, -0.25, 0.4, 2.0, -3.0])
def test_a_frozen_camera_loses_its_vote_when_exposure_moves(side: Side, step: float) -> None:
    steps = [0, 1, 2, 3, 4] if abs(step) < 1.0 else [0, 1, 1]
    votes = votes_after([BEST + step * taken for taken in steps], pair(frozen, side))
    assert votes.faults == {side: "frozen"}


@pytest.mark.parametrize("picture", [black, frozen, white])
def test_a_single_frame_is_not_enough(picture: Picture) -> None:
    """It may be damaged, or the write may have come too late for this camera."""
    votes = votes_after([LOWEST + 3.0, LOWEST + 3.0], {"left": healthy, "right": healthy})
    votes_after([LOWEST], pair(picture, "right"), votes)
    assert votes_after([LOWEST], {"left": healthy, "right": healthy}, votes).faults == {}


def test_one_step_of_exposure_is_enough_for_a_frozen_camera() -> None:
    assert votes_after([BEST, BEST + 1.0, BEST + 1.0], pair(frozen, "right")).faults == {"right": "frozen"}


@pytest.mark.parametrize("side", SIDES)
def test_a_camera_is_not_frozen_while_light_cancels_the_changes_of_exposure(side: Side) -> None:
    """Dusk before a still rig: exposure follows in steps, so at each step the images are again as they were."""
    votes = Votes(dict.fromkeys(SIDES, LINEAR))
    for frame in range(600):
        light = BEST + 0.005 * frame
        level = BEST + 0.25 * round(0.02 * frame)
        looks = [Look(each, healthy(level, light + (each == side)), LINEAR) for each in SIDES]
        votes.see(level, LOWEST, looks)
        assert votes.faults == {}


@given(st.lists(st.floats(LOWEST, 18.0), min_size=2, max_size=12), st.floats(6.0, 16.0), st.floats(-2.5, 2.5))
def test_a_pair_that_responds_alike_keeps_both_votes(levels: list[float], light: float, between: float) -> None:
    """However dark or bright, and with up to 2.5 stops between the cameras."""

    def picture(level: float) -> NDArray[np.uint8]:
        return healthy(level, light)

    def other(level: float) -> NDArray[np.uint8]:
        return healthy(level, light + between, seed=1)

    reached = [level for level in levels if level > LOWEST + 0.5]
    assert votes_after(reached, {"left": picture, "right": other}).faults == {}


@given(
    st.lists(
        st.tuples(st.floats(LOWEST, 18.0), *[st.sampled_from([healthy, black, white, frozen, darker])] * 2), max_size=20
    )
)
def test_a_pair_always_has_a_camera_with_a_vote(frames: list[tuple[float, Picture, Picture]]) -> None:
    votes = Votes(dict.fromkeys(SIDES, LINEAR))
    for level, left, right in frames:
        votes_after([level], {"left": left, "right": right}, votes)
        assert len(votes.faults) < 2


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(("picture", "start"), [(black, BEST), (white, LOWEST), (frozen, BEST + 1.0)])
def test_a_camera_that_shows_something_again_gets_its_vote_back(picture: Picture, start: float, side: Side) -> None:
    votes = votes_after([BEST - 1.0, start, start], pair(picture, side))
    assert list(votes.faults) == [side]
    votes_after([BEST + 0.5] * (RETURN_FRAMES - 1), pair(healthy, side), votes)
    assert list(votes.faults) == [side]
    votes_after([BEST + 0.5], pair(healthy, side), votes)
    assert votes.faults == {}
    assert votes.remark() == ""


def test_a_lens_uncovered_for_a_moment_does_not_count() -> None:
    votes = votes_after([BEST] * 2, pair(black, "right"))
    for _ in range(5):
        votes_after([BEST] * (RETURN_FRAMES // 2), pair(healthy, "right"), votes)
        votes_after([BEST], pair(black, "right"), votes)
    assert votes.faults == {"right": "black"}


@pytest.mark.parametrize("picture", [healthy, black, white, frozen])
def test_a_single_camera_has_a_vote_whatever_it_shows(picture: Picture) -> None:
    assert votes_after([LOWEST, BEST, 18.0], {"right": picture}).faults == {}


def test_lone_frames_of_a_camera_without_a_vote_are_ignored_for_a_second() -> None:
    votes = votes_after([BEST] * 2, pair(black, "right"))
    looks = [Look("right", black(BEST), LINEAR)]
    votes_after([BEST] * (UNHEARD_FRAMES - 1), {"right": black}, votes)
    assert votes.of(looks) == [False]
    votes_after([BEST], {"right": black}, votes)
    assert votes.of(looks) == [True]


def test_a_suspicion_does_not_outlast_the_camera() -> None:
    votes = votes_after([BEST], pair(black, "right"))
    assert votes.undecided
    assert not votes_after([BEST], {"left": healthy}, votes).undecided


@pytest.mark.parametrize("side", SIDES)
def test_a_frozen_camera_is_found_though_exposure_rests_on_it(side: Side) -> None:
    """Light fell, and what is not frozen is black."""
    votes = votes_after([BEST] * 2, pair(frozen, side))
    dark = pair(frozen, side) | {each: darker for each in SIDES if each != side}
    assert votes_after([BEST] * 2, dark, votes).faults == {each: "black" for each in SIDES if each != side}
    assert votes_after([BEST] * REPEATS, dark, votes).faults == {side: "frozen"}


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("darker_stops", [5.0, 8.0])
def test_after_glare_the_brighter_camera_wins(side: Side, darker_stops: float) -> None:
    """The other, 5 or 8 stops darker, was exposed well until then."""

    def dim(level: float) -> NDArray[np.uint8]:
        return healthy(level, BEST + darker_stops)

    votes = votes_after([BEST + darker_stops] * (GLARE_FRAMES - 1), pair(dim, side))
    (other,) = set(SIDES) - {side}
    assert votes.glaring is None
    assert votes_after([BEST + darker_stops], pair(dim, side), votes).glaring == other
    votes_after([BEST + darker_stops - LONGEST_PROBE], pair(dim, side), votes)
    assert votes.glaring is None
    assert votes.faults == {side: "black"}


def test_lone_frames_of_the_other_camera_change_nothing() -> None:
    votes = votes_after([BEST] * 2, pair(black, "right"))
    votes_after([BEST] * 3, {"left": healthy}, votes)
    assert votes.faults == {"right": "black"}


def test_only_pixels_of_the_region_count() -> None:
    """The right camera sees the robot's own lamp at one side, and is capped otherwise."""
    image = black(BEST)
    image[:, :90] = 200
    weights = np.zeros_like(image)
    weights[:, 90:] = 1
    votes = Votes(dict.fromkeys(SIDES, LINEAR))
    for _ in range(2):
        votes.see(BEST, LOWEST, [Look("left", healthy(BEST), LINEAR), Look("right", image, LINEAR, weights)])
    assert votes.faults == {"right": "black"}


def test_the_state_goes_through_plain_data() -> None:
    votes = votes_after([BEST, BEST + 1.0, BEST + 1.0], pair(frozen, "right"))
    copy = Votes(dict.fromkeys(SIDES, LINEAR))
    restore(copy, take(votes))
    for one in (votes, copy):
        assert one.faults == {"right": "frozen"}
        votes_after([BEST] * RETURN_FRAMES, pair(healthy, "right"), one)
    assert votes.faults == copy.faults == {}


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("first_frozen", [0, 1, 20])
def test_a_camera_that_freezes_while_exposure_rests_is_found(side: Side, first_frozen: int) -> None:
    votes = Votes(dict.fromkeys(SIDES, LINEAR))
    for frame in range(first_frozen + REPEATS + 2):
        stuck = min(frame, first_frozen)
        looks = [Look(each, healthy(BEST, seed=stuck if each == side else frame), LINEAR) for each in SIDES]
        votes.see(BEST, LOWEST, looks)
    assert votes.faults == {side: "frozen"}


def test_one_of_a_frozen_and_a_white_camera_keeps_its_vote() -> None:
    rng = np.random.default_rng(1)
    votes = Votes(dict.fromkeys(SIDES, LINEAR))
    for _ in range(2 * REPEATS):
        glare = np.where(rng.random(SHAPE) < 0.95, 255, 200).astype(np.uint8)
        votes.see(LOWEST, LOWEST, [Look("left", frozen(BEST), LINEAR), Look("right", glare, LINEAR)])
        assert len(votes.faults) < 2


def test_a_region_of_a_few_pixels_may_repeat_itself() -> None:
    """One sample is the same for a dozen frames by chance: that freezes no camera."""
    random, votes = np.random.default_rng(0), Votes(dict.fromkeys(SIDES, LINEAR))
    weights = np.zeros(SHAPE, np.uint8)
    weights[16:24, 16:24] = 1
    for _ in range(200):
        grey = np.clip(np.rint(random.normal(120.0, 0.3, SHAPE)), 0, 255).astype(np.uint8)
        votes.see(BEST, LOWEST, [Look("left", grey, LINEAR, weights), Look("right", healthy(BEST), LINEAR)])
        assert votes.faults == {}


def test_a_camera_that_clips_a_little_below_full_scale_is_white_too() -> None:
    votes = votes_after([LOWEST] * 2, pair(lambda _: np.full(SHAPE, 253, np.uint8), "left"))
    assert votes.faults == {"left": "white"}
