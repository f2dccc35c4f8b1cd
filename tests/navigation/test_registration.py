"""The vote by its rules on hand-made matches, and shifts of real pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from navigation.views.features import AdaptiveFinder, Detector, FastOrb, Features, OrbPyramid, Part, UprightSift
from navigation.views.registration import RULES, Registration, VoteRule, register, vote
from tests.navigation.texture import FINDERS, WIDTH, picture, texture

MAJER2018, OURS = RULES["majer2018"], RULES["overlapping"]


def matched(moves: Sequence[tuple[float, float]], rule: VoteRule) -> Registration:
    """Registration of features that moved by these pixels, across and down; each matches only itself."""
    rng = np.random.default_rng(len(moves))
    taught = rng.uniform(100.0, 500.0, (len(moves), 2)).round()
    descriptors = rng.integers(0, 256, (len(moves), 32), np.uint8)
    order = rng.permutation(len(moves))
    seen = taught + np.array(moves, np.float64).reshape(-1, 2)
    ones = np.ones(len(moves))
    return register(Features(taught, ones, descriptors), Features(seen[order], ones, descriptors[order]), rule)


def across(shifts: Sequence[float], rule: VoteRule = MAJER2018) -> Registration:
    return matched([(shift, 0.0) for shift in shifts], rule)


def test_the_first_of_equally_full_bins_wins() -> None:
    assert across([60.0, 61.0, 62.0, -40.0, -41.0, -42.0]).vote.shift_px == -41.0
    assert across([60.0, 61.0, 62.0, 63.0, -40.0, -41.0, -42.0]).vote.shift_px == 61.5


def test_correct_is_what_lies_within_30_px_of_the_centre_and_the_shift_is_their_mean() -> None:
    found = across([1.0, 2.0, 3.0, 29.0, -29.0, 30.0, -30.0, 200.0])
    assert found.vote.shift_px == pytest.approx(6.0 / 5) and found.vote.votes == 5
    taught_order = [False] * 8
    for (index, _), correct in zip(found.matches, found.vote.correct, strict=True):
        taught_order[index] = bool(correct)
    assert taught_order == [True] * 5 + [False] * 3


def test_bins_are_20_px_wide_around_0() -> None:
    # -10 and 9.9 share the bin around 0; 10 is in the next.
    assert across([-10.0, 9.9, 0.0, 250.0, 250.0]).vote.shift_px == pytest.approx(-0.1 / 3)
    assert across([-10.0, 70.0, 70.0, 10.0]).vote.votes == 2
    assert across([409.0, 408.0, 407.0]).vote.shift_px == 408.0
    beyond = across([411.0, 412.0, 413.0, -500.0]).vote
    assert beyond.shift_px is None and beyond.votes == 0
    assert across([411.0, 412.0, 413.0, -500.0], OURS).vote.shift_px == 412.0


def test_what_moved_more_than_50_px_up_or_down_has_no_vote() -> None:
    moves = [(100.0, 51.0)] * 3 + [(100.0, -51.0)] * 2 + [(21.0, 50.0)] * 2 + [(21.0, -50.0)]
    found = matched(moves, MAJER2018)
    assert found.vote.shift_px == 21.0 and found.vote.votes == len(found.matches) == 3
    assert matched(moves, OURS).vote.shift_px == 100.0


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
def test_fewer_than_three_are_no_shift(rule: VoteRule) -> None:
    for shifts in ([], [5.0], [5.0, 6.0], [5.0, 6.0, 200.0, -200.0]):
        assert across(shifts, rule).vote.shift_px is None
    assert across([5.0, 6.0, 200.0], rule).vote.votes == 2
    assert across([4.0, 90.0, 5.0, 6.0], rule).vote.shift_px == pytest.approx(5.0)


def test_ours_votes_for_what_most_agree_on() -> None:
    rng = np.random.default_rng(1)
    agreeing, scattered = rng.normal(-23.0, 1.0, 40), rng.uniform(-300.0, 300.0, 120)
    won = vote(np.concatenate([agreeing, scattered]))
    assert won.shift_px == pytest.approx(-23.0, abs=0.7) and 40 <= won.votes < 50
    assert won.correct[:40].all()
    edges = vote(np.array([0.0, 0.0, 0.0, 9.9, 10.0, -7.0]))  # a bin has its lower edge, not its upper one
    assert edges.shift_px == pytest.approx(9.9 / 4) and edges.correct.tolist() == [True] * 4 + [False] * 2


def test_a_match_must_be_clearly_better_than_the_second_best() -> None:
    """Second best at 100 bits: 69 pass a ratio of 0.7, 70 do not, and neither do two equal ones."""

    def at(bits: int) -> np.ndarray:
        return np.packbits(np.arange(256) < bits)

    positions = np.array([[50.0, 50.0], [150.0, 50.0]])
    for bits, expected in ((69, 1), (70, 0), (100, 0)):
        taught = Features(positions[:1].repeat(2, 0), np.ones(2), np.stack([at(0), at(256)]))
        seen = Features(positions, np.ones(2), np.stack([at(bits), at(0) | at(256) & ~at(156)]))
        found = register(taught, seen, MAJER2018).matches
        assert np.count_nonzero(found[:, 0] == 0) == expected


@pytest.mark.parametrize("kind", FINDERS)
def test_shifted_views_are_registered_by_their_shift_and_mirrored_ones_by_its_opposite(kind: str) -> None:
    rng, scene = np.random.default_rng(2), 128.0 + 30.0 * texture(3, WIDTH + 400)

    def view(shift_px: int, mirror: bool) -> Features:
        image = picture(scene[:, 200 - shift_px : 200 - shift_px + WIDTH], rng, noise=4.0)
        finder = FINDERS[kind]()
        for _ in range(3):  # so that the threshold has settled
            found: Features = finder.find(np.ascontiguousarray(image[:, ::-1]) if mirror else image)
        return found

    for mirror, side in ((False, 1.0), (True, -1.0)):
        taught = view(0, mirror)
        for shift_px in (-200, 37, 200):
            seen = view(shift_px, mirror)
            for rule in RULES.values():
                won = register(taught, seen, rule).vote
                assert won.shift_px == pytest.approx(side * shift_px, abs=1.0) and won.votes > 50


@pytest.mark.parametrize("kind", FINDERS)
def test_pictures_without_features_have_no_shift(kind: str) -> None:
    full = FINDERS[kind]().find(picture(128.0 + 30.0 * texture(4), np.random.default_rng(4)))
    black = FINDERS[kind]().find(np.zeros((540, 720), np.uint8))
    assert len(black) == 0 and len(full) > 300
    for taught, seen in ((black, full), (full, black), (black, black)):
        found = register(taught, seen)
        assert found.vote.shift_px is None and found.vote.votes == 0 and found.matches.shape == (0, 2)


@pytest.mark.parametrize("kind", FINDERS)
def test_pictures_smaller_than_the_border_have_no_features(kind: str) -> None:
    scene, finder = picture(128.0 + 60.0 * texture(5), np.random.default_rng(5), 8.0), FINDERS[kind]()
    for height in (0, 1, 5, 10, 11, 12, 31, 61, 62, 63, 64, 80, 130):
        for width in (0, 1, 11, 62, 63, 64, 720):
            found = finder.find(scene[:height, :width])
            assert len(found) == len(found.descriptors) == len(found.responses)
            if min(height, width) <= 10:
                assert len(found) == 0
    assert len(finder.find(scene)) > 0


@pytest.mark.parametrize("kind", FINDERS)
def test_every_feature_is_described_and_lies_in_the_top_half(kind: str) -> None:
    found = FINDERS[kind]().find(picture(128.0 + 30.0 * texture(6), np.random.default_rng(6)))
    assert found.positions.shape == (len(found), 2) and found.descriptors.shape[0] == len(found)
    assert found.positions[:, 1].max() < 271 and found.positions[:, 1].max() > 230
    if kind != "orb-pyramid":
        assert len(found) == 500 == len({tuple(place) for place in found.positions})
        assert (np.diff(found.responses) <= 0).all()


@pytest.mark.parametrize(("detector", "upright"), [(FastOrb, True), (UprightSift, True), (None, False)])
def test_what_is_upright_does_not_recognise_a_picture_that_lies_on_its_side(
    detector: type[Detector] | None, upright: bool
) -> None:
    image = picture(128.0 + 30.0 * texture(9)[:400, :400], np.random.default_rng(9))
    taught, seen = (
        OrbPyramid().find(turned, "whole image")
        if detector is None
        else AdaptiveFinder(detector(), "whole image").find(turned)
        for turned in (image, np.ascontiguousarray(np.rot90(image)))
    )
    assert (len(register(taught, seen).matches) < 0.1 * len(taught)) == upright


@pytest.mark.parametrize("part", ["top half", "whole image"])
def test_the_lower_half_is_looked_at_only_on_request(part: Part) -> None:
    image = np.full((540, 720), 128, np.uint8)
    image[330:] = picture(128.0 + 30.0 * texture(7), np.random.default_rng(7))[330:]
    assert (part == "top half") == (len(OrbPyramid().find(image, part)) == 0)


def test_mistakes_are_told_in_a_sentence() -> None:
    finder = FINDERS["fast-orb"]()
    for wrong in (np.zeros((9, 9, 3), np.uint8), np.zeros((9, 9)), np.zeros(9, np.uint8)):
        with pytest.raises(ValueError, match="convert it to 8-bit grey"):
            finder.find(wrong)
    image = picture(128.0 + 30.0 * texture(8), np.random.default_rng(8))
    with pytest.raises(ValueError, match="use the detector that the map was taught with"):
        register(finder.find(image), FINDERS["sift"]().find(image))
