"""The threshold's law: on made-up responses, and in closed loop with real detectors."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from navigation.views.features import (
    BEST,
    FITTED,
    WANTED,
    AdaptiveFinder,
    Detector,
    FastOrb,
    UprightSift,
    next_threshold,
)
from tests.navigation.texture import picture, texture

LEAST = 0.01


def test_with_too_many_features_it_is_the_response_of_the_first_superfluous_one() -> None:
    responses = np.random.default_rng(0).permutation(np.arange(1.0, 1001.0))
    assert next_threshold(responses, LEAST) == 1000.0 - WANTED
    assert next_threshold(responses, 600.0) == 600.0


def test_with_too_few_the_last_ten_are_continued_by_least_squares() -> None:
    strong, rng = np.linspace(900.0, 300.0, 390), np.random.default_rng(1)
    weak = np.sort(rng.uniform(200.0, 250.0, FITTED))[::-1]
    line = np.polynomial.Polynomial.fit(np.arange(391, 401), weak, 1)
    assert float(line(WANTED)) < 0.0  # too steep
    assert next_threshold(np.concatenate([strong, weak]), LEAST) == LEAST
    weak = 200.0 + (weak - weak.mean()) / 100
    line = np.polynomial.Polynomial.fit(np.arange(391, 401), weak, 1)
    assert next_threshold(np.concatenate([strong, weak]), LEAST) == pytest.approx(float(line(WANTED)))


@pytest.mark.parametrize("count", [0, 1, FITTED - 1])
def test_with_too_few_for_a_line_it_is_the_least(count: int) -> None:
    assert next_threshold(np.full(count, 50.0), LEAST) == LEAST


def test_equal_scores_do_not_stop_it() -> None:
    """Of 200 corners with a score of 20 there are 200 in one grey level, so 450 more need about two and a quarter."""
    scores = np.full(200, 20.0)
    assert next_threshold(scores, 1.0, step=1.0) == pytest.approx(20.0 - 2.25, abs=0.01)
    assert next_threshold(np.concatenate([scores, np.full(500, 30.0)]), 1.0, step=1.0) > 20.0


DISTRIBUTIONS = {
    "exponential": lambda rng, count: rng.exponential(1.0, count),
    "heavy tail": lambda rng, count: rng.pareto(2.0, count),
    "lognormal": lambda rng, count: rng.lognormal(0.0, 1.0, count),
    "even": lambda rng, count: rng.uniform(0.0, 2.0, count),
}


@given(
    st.sampled_from(sorted(DISTRIBUTIONS)),
    st.integers(2000, 8000),
    st.sampled_from([0.5, 2.0, 0.125, 8.0]),
    st.sampled_from([0.0, 1.0]),
    st.integers(0, 1000),
)
def test_after_a_step_of_contrast_the_wanted_number_is_found_again(
    kind: str, count: int, factor: float, step: float, seed: int
) -> None:
    contrast = DISTRIBUTIONS[kind](np.random.default_rng(seed), count) * (200.0 if step else 1.0)
    least, threshold = (1.0, 20.0) if step else (LEAST, 0.5)
    for scale in (1.0, factor):
        responses = contrast * scale
        if step:
            responses = np.floor(responses)
        for _ in range(5):
            found = responses[responses >= (int(threshold) if step else threshold)]
            threshold = next_threshold(found, least, step)
            assert threshold >= least
        # What the same score decides cannot be parted: the wanted number lies within that score.
        at, above = (np.count_nonzero(responses >= np.floor(threshold) + more) for more in (0, step))
        assert 0.9 * WANTED <= len(found) <= 1.1 * WANTED or (step and 0.9 * above <= WANTED <= 1.1 * at)


def counts_of(finder: AdaptiveFinder, pictures: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many features the detector found in each, before the best were kept."""
    counts: list[int] = []

    def counted(responses: NDArray[np.float64], least: float, step: float) -> float:
        counts.append(len(responses))
        threshold = next_threshold(responses, least, step)
        assert threshold >= least
        return threshold

    monkeypatch.setattr("navigation.views.features.next_threshold", counted)
    for image in pictures:
        assert len(finder.find(image)) == min(counts[-1], BEST)
    return counts


@pytest.mark.parametrize("kind", [FastOrb, UprightSift])
def test_real_detectors_follow_the_contrast_of_pictures(kind: type[Detector], monkeypatch: pytest.MonkeyPatch) -> None:
    rng, scene = np.random.default_rng(3), texture(4)
    least = 10.0 if kind is FastOrb else 5.0  # below that, hundreds of corners have the same score
    contrasts = [40.0] * 5 + [20.0] * 5 + [40.0] * 5 + [least] * 5
    pictures = [picture(128.0 + contrast * scene, rng) for contrast in contrasts]
    counts = counts_of(AdaptiveFinder(kind()), pictures, monkeypatch)
    for settled in counts[4::5]:
        assert 500 <= settled <= 800
    assert min(counts[5], counts[15]) < 500  # the law acts one frame late


@pytest.mark.parametrize("kind", [FastOrb, UprightSift])
def test_a_static_scene_does_not_oscillate(kind: type[Detector], monkeypatch: pytest.MonkeyPatch) -> None:
    still = picture(128.0 + 30.0 * texture(5), np.random.default_rng(6))
    counts = counts_of(AdaptiveFinder(kind()), [still] * 9, monkeypatch)[4:]
    assert max(abs(after - before) for before, after in pairwise(counts)) <= 10 and min(counts) >= 640


@pytest.mark.parametrize("kind", [FastOrb, UprightSift])
def test_it_lives_with_an_exposure_loop(kind: type[Detector], monkeypatch: pytest.MonkeyPatch) -> None:
    """The light changes four-fold, both ways; the law of the paper's exposure (3.2) brings the mean back to 0.5."""
    rng, radiance, exposure = np.random.default_rng(7), 100.0 * np.exp2(0.6 * texture(8)), 1.0
    pictures = []
    for frame in range(24):
        light = 4.0 if 8 <= frame < 16 else 1.0
        pictures.append(picture(radiance * light * exposure, rng))
        if frame % 2:
            exposure *= 1.0 + 0.9 * (0.5 / (float(pictures[-1][:270].mean()) / 255) - 1.0)
    counts = counts_of(AdaptiveFinder(kind()), pictures, monkeypatch)
    for settled in (7, 15, 23):
        assert 500 <= counts[settled] <= 800
    assert min(counts[8], counts[16]) < 500 or max(counts[8], counts[16]) > 800


def test_a_dark_picture_leaves_the_least_threshold_and_the_next_recovers(monkeypatch: pytest.MonkeyPatch) -> None:
    finder, scene = AdaptiveFinder(FastOrb()), picture(128.0 + 30.0 * texture(9), np.random.default_rng(9))
    counts = counts_of(finder, [scene] * 3 + [np.zeros_like(scene)], monkeypatch)
    assert counts[-1] == 0 and finder.threshold == FastOrb.least
    assert 500 <= counts_of(finder, [scene] * 3, monkeypatch)[-1] <= 800
