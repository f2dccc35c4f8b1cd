"""The rule by which a policy is recommended, on figures whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.rejudge.decide import SEGMENT_S, Margins, SeenSegment, decide, differences

PRESENT = "belief"
MARGINS = Margins()
SPREAD = 0.35
"""Of the logarithm of an error from segment to segment, beside what segments do to all policies alike."""


def segments(
    seed: int,
    number: int,
    better: float = 0.0,
    *,
    drives: int = 1,
    lost_share: float = 0.01,
    more_matches: float = 0.0,
) -> list[SeenSegment]:
    """Of a policy whose error is truly so much smaller, as a share; the same ground for each policy."""
    ground = np.random.default_rng([drives, number]).normal(0.0, 0.5, number)
    own = np.random.default_rng([seed, drives, number])
    errors_mm = 2.0 * (1.0 - better) * np.exp(ground + own.normal(0.0, SPREAD, number))
    matches = 250.0 * (1.0 + more_matches) + own.normal(0.0, 20.0, number)
    lost = np.clip(lost_share + own.normal(0.0, 0.01, number), 0.0, 1.0)
    return [
        SeenSegment(f"drive{place % drives}", place // drives, float(error), float(share), float(match))
        for place, (error, share, match) in enumerate(zip(errors_mm, lost, matches, strict=True))
    ]


def minutes(count: float) -> int:
    return round(count * 60 / SEGMENT_S)


@pytest.mark.parametrize("drives", [1, 4, 24])
def test_policies_that_are_alike_are_seldom_told_apart(drives: int) -> None:
    """Six of them against the present one."""
    false = 0
    for draw in range(50):
        seen = {name: segments(10 * draw + place, minutes(20), drives=drives) for place, name in enumerate("abcdef")}
        false += (
            decide({PRESENT: segments(10 * draw + 9, minutes(20), drives=drives), **seen}, PRESENT).policy is not None
        )
    assert false <= 2


def test_twice_the_margin_is_found_in_twenty_minutes() -> None:
    found = 0
    for draw in range(50):
        seen = {name: segments(10 * draw + place, minutes(20)) for place, name in enumerate("abcde")}
        seen["better"] = segments(10 * draw + 8, minutes(20), 2 * MARGINS.odometry)
        found += decide({PRESENT: segments(10 * draw + 9, minutes(20)), **seen}, PRESENT).policy == "better"
    assert found >= 45


JUDGED = json.loads((Path(__file__).parent / "judged_segments.json").read_text())
"""Segments of simulated drives, by `python -m benchmarks.bench_rejudge`: each course driven twice, with other noise."""
TWENTY_MINUTES = round(20 * 60 / SEGMENT_S)
DRAWS = 200


def drawn(policy: str, draw: int, number: int, better: float = 0.0) -> dict[str, list[SeenSegment]]:
    """So many of the judged segments with repetition, in drives of a minute; and the same courses in other noise, once
    the one and once the other for the present policy: there is no true difference but the one that is given."""
    random = np.random.default_rng([draw, number])
    of_course: dict[str, list[list[Any]]] = {}
    for name, *figures in JUDGED[policy]:
        of_course.setdefault(name.partition("-")[0], []).append(figures)
    courses = [both for both in of_course.values() if len(both) == 2]
    seen: dict[str, list[SeenSegment]] = {PRESENT: [], "other": []}
    for place in range(number):
        both = courses[random.integers(len(courses))]
        for name, figures in zip(seen, random.permutation(2), strict=True):
            error_mm, lost, matches = both[figures]
            if error_mm is not None and name == "other":
                error_mm *= 1.0 - better
            seen[name].append(SeenSegment(f"drive{place // 6}", place % 6, error_mm, lost, matches))
    return seen


@pytest.mark.parametrize("policy", JUDGED)
def test_of_simulated_drives_noise_decides_seldom_and_twice_the_margin_in_twenty_minutes(policy: str) -> None:
    alike = [decide(drawn(policy, draw, TWENTY_MINUTES), PRESENT).policy for draw in range(DRAWS)]
    assert alike.count("other") <= 0.05 * DRAWS
    better = [
        decide(drawn(policy, draw, TWENTY_MINUTES, 2 * MARGINS.odometry), PRESENT).policy for draw in range(DRAWS)
    ]
    assert better.count("other") >= 0.9 * DRAWS
    short = [decide(drawn(policy, draw, 2), PRESENT) for draw in range(DRAWS)]
    assert all(one.policy is None and one.more_minutes for one in short)


def test_a_short_drive_decides_nothing_and_says_how_much_is_missing() -> None:
    seen = {PRESENT: segments(0, 2), "a": segments(1, 2, 0.03)}
    made = decide(seen, PRESENT)
    assert made.policy is None
    assert "20 s" in made.why and f"stay with {PRESENT}" in made.why
    assert made.more_minutes is not None and f"{made.more_minutes:.0f} more minutes" in made.why
    assert decide({PRESENT: segments(0, 1), "a": segments(1, 1)}, PRESENT).policy is None


def test_as_much_more_as_it_says_decides() -> None:
    few, seed = minutes(2), 3
    made = decide({PRESENT: segments(seed, few), "a": segments(seed + 1, few, 0.2)}, PRESENT)
    assert made.policy is None and made.more_minutes is not None
    enough = 2 * (few + minutes(made.more_minutes))
    assert decide({PRESENT: segments(seed, enough), "a": segments(seed + 1, enough, 0.2)}, PRESENT).policy == "a"


@pytest.mark.parametrize(
    ("other", "recommended", "words"),
    [
        ({"more_matches": 0.01}, None, ["no other policy is better", "20 minutes"]),
        ({"more_matches": 0.2}, "other", ["more matches"]),
        ({"lost_share": 0.0, "more_matches": -0.2}, None, []),
        ({"better": 0.4, "lost_share": 0.2}, None, []),
        ({"better": 0.4, "more_matches": -0.5}, "other", ["error of odometry", "smaller"]),
        ({"better": -0.4, "more_matches": 0.5}, None, []),
    ],
)
def test_what_decides_first(other: dict[str, float], recommended: str | None, words: Sequence[str]) -> None:
    calm = {"number": minutes(20), "seed": 1}
    seen = {PRESENT: segments(**calm), "other": segments(**calm, **other)}  # type: ignore[arg-type]
    made = decide(seen, PRESENT)
    assert made.policy == recommended, made
    assert all(word in made.why for word in words), made.why


def test_a_segment_without_any_error_does_not_decide_alone() -> None:
    """Frames that are the shots of the reference itself."""
    seen = {PRESENT: segments(1, minutes(20)), "other": segments(2, minutes(20), -0.3)}
    seen["other"][5] = replace(seen["other"][5], rpe_mm=1e-15)
    assert decide(seen, PRESENT).policy is None
    (found,) = differences(seen, PRESENT)
    assert found.odometry is not None and found.odometry.high < 0.0


def test_lost_pairs_decide_where_errors_are_alike() -> None:
    calm = {"number": minutes(20), "seed": 1}
    seen = {PRESENT: segments(**calm, lost_share=0.1), "other": segments(**calm, more_matches=-0.3)}
    made = decide(seen, PRESENT)
    assert made.policy == "other" and "fewer of the pairs are lost" in made.why


def test_without_matches_nothing_is_decided() -> None:
    blind = [SeenSegment("a", place, None, None, None) for place in range(minutes(20))]
    made = decide({PRESENT: blind, "other": blind}, PRESENT)
    assert made.policy is None and "nothing was matched" in made.why


def test_drives_are_what_is_drawn_where_there_are_many() -> None:
    """Segments of a drive are alike: were they drawn alone, intervals would be too narrow."""
    seen = {PRESENT: [], "other": []}
    random = np.random.default_rng(1)
    for drive in range(12):
        for number in range(20):
            shift = 0.3 * np.sin(3.0 * drive)
            for policy, more in ((PRESENT, 0.0), ("other", shift)):
                error_mm = 2.0 * float(np.exp(random.normal(more, 0.05)))
                seen[policy].append(SeenSegment(f"d{drive}", number, error_mm, 0.0, 200.0))
    (together,) = differences(seen, PRESENT)
    apart = {
        name: [SeenSegment("one", place, one.rpe_mm, 0.0, 200.0) for place, one in enumerate(rows)]
        for name, rows in seen.items()
    }
    (alone,) = differences(apart, PRESENT)
    assert together.odometry is not None and alone.odometry is not None
    assert together.odometry.high - together.odometry.low > 2 * (alone.odometry.high - alone.odometry.low)


@pytest.mark.parametrize(("lower_still", "recommended"), [(0.0, "lu2010"), (0.35, "lu2010:max_time_us=3000")])
def test_a_limit_is_recommended_only_if_it_is_better_than_the_policy_without(
    lower_still: float, recommended: str
) -> None:
    """Both are better than the present policy."""
    errors = 1.0 - 0.65 * (1.0 - lower_still)
    seen = {
        PRESENT: segments(1, minutes(20)),
        "lu2010": segments(2, minutes(20), 0.35),
        "lu2010:max_time_us=3000": segments(3, minutes(20), errors + 0.005),
    }
    assert decide(seen, PRESENT).policy == recommended
