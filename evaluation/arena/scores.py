"""The scores of one run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluation.arena.successive import LOST

SETTLED_RATIO = 0.9
SETTLED_FRAMES = 10
"""Settled: at least this share of the oracle's objective for this many frames in a row."""

STEADY_FRAMES = 30
"""The steady state is the last half second."""

BAD_SHARE = 0.5
"""A frame with a larger share of black and saturated pixels is bad."""


@dataclass(frozen=True, slots=True)
class Score:
    """The scores of one run, over its scored frames.

    Attributes
    ----------
    settle_frames
        Frames from the first scored one (after a step: the first exposed entirely after it) to the first of ten in a
        row that are settled; 0 when the first one is settled, None when the run never settles: it is stuck.
    overshoot_stops
        How far the exposure level went past the oracle's, in the direction from the level of the first scored frame
        to the oracle's there; 0 when it stayed on its side. Only frames before settling count, and the oracle's level
        is the middle of its plateau.
    steady_std_stops
        Standard deviation of the exposure level over the last 30 frames.
    metric_ratio_mean, metric_ratio_p05
        Mean and fifth percentile of M_g as a share of the oracle's.
    bad_frame_share
        Share of frames whose left image is more than half black or saturated.
    gain_db_mean
        Mean gain.
    objective_ratio_mean, objective_ratio_p05
        Mean and fifth percentile of what the policy maximises, information or M_g, as a share of the oracle's.
    any_split_ratio_mean
        Mean of M_g as a share of the best of all exposure times and gains, however the policy splits.
    pair_ratio_mean
        Mean information of two successive frames, as a share of the most that one setting for both gives.
    lost_pair_share
        Share of pairs with less than a tenth of it.
    """

    settle_frames: int | None
    overshoot_stops: float
    steady_std_stops: float
    metric_ratio_mean: float
    metric_ratio_p05: float
    bad_frame_share: float
    gain_db_mean: float
    objective_ratio_mean: float
    objective_ratio_p05: float
    any_split_ratio_mean: float
    pair_ratio_mean: float
    lost_pair_share: float


def score(
    *,
    levels: NDArray[np.float64],
    oracle_levels: NDArray[np.float64],
    ratios: NDArray[np.float64],
    metric_ratios: NDArray[np.float64],
    any_split_ratios: NDArray[np.float64],
    pair_ratios: NDArray[np.float64],
    clipped_shares: NDArray[np.float64],
    gains_db: NDArray[np.float64],
    first_scored: int,
) -> Score:
    """The scores of a run; all arrays have shape (frames,), and frames before `first_scored` do not count.

    `ratios` and `oracle_levels` are by what the policy maximises, `metric_ratios` and `any_split_ratios` by M_g,
    `pair_ratios` by the information of pairs. Frames whose ratio is NaN (no exposure shows anything) neither count as
    settled nor enter the ratios.
    """
    scored = slice(first_scored, None)
    settle = frames_to_settle(ratios[scored])
    by_objective, by_metric, by_any_split, pairs = (
        each[scored][~np.isnan(each[scored])] for each in (ratios, metric_ratios, any_split_ratios, pair_ratios)
    )
    return Score(
        settle_frames=settle,
        overshoot_stops=overshoot(levels[scored], oracle_levels[scored], settle),
        steady_std_stops=float(levels[-STEADY_FRAMES:].std()),
        metric_ratio_mean=_mean(by_metric),
        metric_ratio_p05=_worst(by_metric),
        bad_frame_share=float(np.mean(clipped_shares[scored] > BAD_SHARE)),
        gain_db_mean=float(gains_db[scored].mean()),
        objective_ratio_mean=_mean(by_objective),
        objective_ratio_p05=_worst(by_objective),
        any_split_ratio_mean=_mean(by_any_split),
        pair_ratio_mean=_mean(pairs),
        lost_pair_share=float(np.mean(pairs < LOST)) if pairs.size else 1.0,
    )


def _mean(ratios: NDArray[np.float64]) -> float:
    return float(ratios.mean()) if ratios.size else 0.0


def _worst(ratios: NDArray[np.float64]) -> float:
    return float(np.percentile(ratios, 5)) if ratios.size else 0.0


def frames_to_settle(ratios: NDArray[np.float64]) -> int | None:
    """Index of the first of ten ratios in a row of at least 0.9; None when there is no such row."""
    good = np.convolve(ratios >= SETTLED_RATIO, np.ones(SETTLED_FRAMES), "valid") if ratios.size else np.empty(0)
    settled = np.flatnonzero(np.rint(good) == SETTLED_FRAMES)
    return int(settled[0]) if settled.size else None


def overshoot(levels: NDArray[np.float64], oracle_levels: NDArray[np.float64], settle: int | None) -> float:
    """How far (stops) the levels went past the oracle's before settling; see `Score`."""
    end = len(levels) if settle is None else settle + 1
    direction = np.sign(oracle_levels[0] - levels[0])
    beyond = direction * (levels[:end] - oracle_levels[:end])
    return float(max(beyond.max(initial=0.0), 0.0)) if np.isfinite(direction) else 0.0
