from __future__ import annotations

import numpy as np
import pytest

from evaluation.arena.scores import Score, frames_to_settle, score

ON_TARGET = [1.0] * 10


def scored(
    levels: list[float], oracle: list[float], ratios: list[float], clipped: list[float], first: int = 0
) -> Score:
    return score(
        levels=np.array(levels),
        oracle_levels=np.array(oracle),
        ratios=np.array(ratios),
        metric_ratios=np.array(ratios) / 2,
        any_split_ratios=np.array(ratios) / 4,
        pair_ratios=np.array(ratios) / 8,
        clipped_shares=np.array(clipped),
        gains_db=np.arange(len(levels), dtype=float),
        first_scored=first,
    )


@pytest.mark.parametrize(
    ("ratios", "frames"),
    [
        (ON_TARGET, 0),
        ([0.2, 0.3, *ON_TARGET], 2),
        ([1.0] * 9 + [0.89, *ON_TARGET], 10),
        ([0.9] * 10, 0),
        ([1.0] * 9, None),
        ([], None),
        ([np.nan, *ON_TARGET], 1),
    ],
)
def test_settled_is_nine_tenths_for_ten_frames(ratios: list[float], frames: int | None) -> None:
    assert frames_to_settle(np.array(ratios)) == frames


def test_frames_before_the_first_scored_one_do_not_count() -> None:
    figures = scored([5.0] * 8 + [9.0] * 12, [9.0] * 20, [0.0] * 8 + [1.0] * 12, [0.9] * 8 + [0.1] * 12, first=8)

    assert figures.settle_frames == 0
    assert figures.objective_ratio_mean == 1.0
    assert figures.bad_frame_share == 0.0
    assert figures.gain_db_mean == pytest.approx(13.5)


def test_overshoot_is_beyond_the_oracle_and_before_settling() -> None:
    levels = [8.0, 10.0, 13.5, *[12.0] * 20, 15.0]
    figures = scored(levels, [12.0] * 24, [0.1, 0.5, 0.5, *[1.0] * 21], [0.0] * 24)

    assert figures.settle_frames == 3
    assert figures.overshoot_stops == pytest.approx(1.5)


def test_approaching_from_above_overshoots_below() -> None:
    figures = scored([12.0, 7.5, *[8.0] * 20], [8.0] * 22, [0.1, 0.1, *[1.0] * 20], [0.0] * 22)

    assert figures.overshoot_stops == pytest.approx(0.5)


def test_steady_state_is_the_last_half_second() -> None:
    figures = scored([0.0] * 30 + [10.0, 11.0] * 15, [10.5] * 60, [1.0] * 60, [0.0] * 60)

    assert figures.steady_std_stops == pytest.approx(0.5)


def test_bad_frames_are_more_than_half_clipped() -> None:
    assert scored([1.0] * 4, [1.0] * 4, [1.0] * 4, [0.5, 0.51, 1.0, 0.0]).bad_frame_share == 0.5


def test_frames_without_anything_to_see_do_not_count_in_ratios() -> None:
    figures = scored([1.0] * 4, [1.0] * 4, [np.nan, 0.5, 1.0, np.nan], [0.0] * 4)

    assert figures.objective_ratio_mean == 0.75
    assert figures.metric_ratio_mean == 0.375
    assert figures.any_split_ratio_mean == 0.1875
    assert figures.pair_ratio_mean == 0.09375 and figures.lost_pair_share == 0.5
    assert figures.settle_frames is None


def test_a_course_without_anything_to_see_is_stuck_with_ratio_0() -> None:
    figures = scored([1.0] * 12, [np.nan] * 12, [np.nan] * 12, [1.0] * 12)

    assert figures == Score(None, 0.0, 0.0, 0.0, 0.0, 1.0, 5.5, 0.0, 0.0, 0.0, 0.0, 1.0)
