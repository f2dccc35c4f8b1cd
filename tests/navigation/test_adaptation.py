"""How maps change when they are passed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from navigation.maps.adaptation import LocalMap, Strategy, adapt
from navigation.views.features import Features
from navigation.views.registration import RULES, register

SHIFT_PX = 40.0


def some_features(random: np.random.Generator, count: int) -> Features:
    """Anywhere, with descriptors that have nothing in common."""
    descriptors = random.integers(0, 256, (count, 32)).astype(np.uint8)
    return Features(random.uniform(100, 600, (count, 2)), random.random(count), descriptors)


def passed(
    seed: int, strategy: Strategy, lost: int = 25, new: int = 30
) -> tuple[LocalMap, Features, LocalMap, NDArray[np.int8]]:
    """A map, the view, the map afterwards, and its states: 60 features are found shifted, 5 at a wrong place."""
    random = np.random.default_rng(seed)
    taught = some_features(random, 65 + lost)
    found = taught.take(np.arange(65)).moved(SHIFT_PX)
    found.positions[60:, 0] += random.uniform(200, 900, 5)
    seen = found.joined(some_features(random, new))
    before = LocalMap(taught, random.integers(-3, 4, len(taught)), np.arange(100, 100 + len(taught)))
    passing = adapt(before, seen, register(taught, seen, RULES["overlapping"]), strategy, 1000)
    return before, seen, passing.after, passing.states


def test_states_are_correct_wrong_and_unmatched() -> None:
    *_, states = passed(1, "static")
    assert states.tolist() == [1] * 60 + [-1] * 5 + [0] * 25


def test_a_static_map_only_counts() -> None:
    before, _, after, states = passed(1, "static")
    assert after.features is before.features and (after.scores == before.scores + states).all()


def test_a_plastic_map_is_the_view_moved_back() -> None:
    _, seen, after, _ = passed(1, "plastic")
    assert after.features.positions == pytest.approx(seen.positions - (SHIFT_PX, 0.0), abs=1e-9)
    assert (after.features.descriptors == seen.descriptors).all() and not after.scores.any()


@given(st.integers(0, 10_000), st.integers(0, 60), st.integers(0, 60))
@settings(max_examples=40)
def test_an_adaptive_map_keeps_its_size_and_its_best(seed: int, lost: int, new: int) -> None:
    before, _, after, states = passed(seed, "adaptive", lost=lost, new=new)
    assert len(after) == len(before)
    exchanged = after.ids >= 1000
    assert exchanged.sum() == min(30, new)  # half of 60 votes
    assert len(np.unique(after.ids)) == len(after)
    scores = before.scores + states
    kept = np.isin(before.ids, after.ids)
    assert kept.all() or scores[~kept].max() <= scores[kept].min(initial=99)


def test_new_features_are_stored_where_the_map_would_have_seen_them() -> None:
    _, seen, after, _ = passed(2, "adaptive")
    added = after.take(after.ids >= 1000)
    places = {bytes(descriptor): place for descriptor, place in zip(seen.descriptors, seen.positions, strict=True)}
    for descriptor, place in zip(added.features.descriptors, added.features.positions, strict=True):
        assert place == pytest.approx(places[bytes(descriptor)] - (SHIFT_PX, 0.0), abs=1e-9)


def test_a_summary_only_loses_features_below_zero() -> None:
    before, _, after, states = passed(3, "summary")
    scores = before.scores + states
    gone = ~np.isin(before.ids, after.ids)
    lowest = np.sort(scores)[:30]
    assert gone.sum() == (lowest < 0).sum() and scores[gone].max() < 0
    assert len(after) == len(before) - gone.sum() + 30


def test_what_is_least_like_the_map_is_taken_first() -> None:
    random = np.random.default_rng(5)
    taught = some_features(random, 40)
    near = taught.descriptors[:30].copy()
    near[:, 0] ^= 255  # 8 of 256 bits differ
    twins = Features(taught.positions[:30], taught.responses[:30], near)
    unlike = some_features(random, 15)
    seen = taught.joined(unlike).joined(twins)
    passing = adapt(LocalMap.taught(taught), seen, register(taught, seen), "adaptive", 40)
    added = {bytes(row) for row in passing.after.features.descriptors[passing.added]}
    assert {bytes(row) for row in unlike.descriptors} <= added
    assert passing.removed.size == passing.added.sum() == 20


@given(st.integers(0, 10_000), st.sampled_from(["static", "plastic", "adaptive", "summary"]))
@settings(max_examples=30)
def test_a_failed_registration_changes_nothing(seed: int, strategy: Strategy) -> None:
    random = np.random.default_rng(seed)
    before = LocalMap(some_features(random, 50), random.integers(-3, 4, 50), np.arange(50))
    copies = [array.tobytes() for array in (before.features.positions, before.features.descriptors, before.scores)]
    seen = some_features(random, 50)
    registration = register(before.features, seen)
    assert registration.vote.shift_px is None
    passing = adapt(before, seen, registration, strategy, 50)
    after = passing.after
    assert [each.tobytes() for each in (after.features.positions, after.features.descriptors, after.scores)] == copies
    assert (after.ids == before.ids).all() and not passing.states.any() and not passing.removed.size
    assert not passing.added.any()
