"""What the drives over a map show: how much was seen again, what stayed, and whether it could be foretold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navigation.maps.path import TaughtPath
from navigation.maps.temporal import MODELS, FeatureHistory
from navigation.store import MapDrive, MapFile, Place

LEAST_PASSINGS = 4
"""Passings of a local map that a model needs, to learn from all but the last."""

BINS = 10
"""Bins of the foretold probability."""

_STEP_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Foretold:
    """What a model foretold about the last passing of each local map, from the passings before.

    Attributes
    ----------
    model
        One of `MODELS`.
    brier
        Mean squared difference from what was seen (0 or 1); NaN for a model whose scores are not probabilities.
    foretold, seen
        Means by bin of the foretold probability, float64, (bins,).
    """

    model: str
    brier: float
    foretold: NDArray[np.float64]
    seen: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything that the page shows.

    Attributes
    ----------
    plan_m
        The path from above as it was taught, float64, (n, 2); the start is at 0, ahead is up.
    marks_m
        The local maps on it, float64, (places, 2).
    runs
        All drives that repeated the path.
    seen_share
        Share of the features of each local map seen in each of them, float64, (runs, places); NaN: not registered.
    taught, kept
        Features that were taught, and those of them still there after each run, (runs,).
    total
        All features after each run, (runs,).
    foretold
        By model; empty with too few drives.
    """

    plan_m: NDArray[np.float64]
    marks_m: NDArray[np.float64]
    runs: list[MapDrive]
    seen_share: NDArray[np.float64]
    taught: int
    kept: NDArray[np.int64]
    total: NDArray[np.int64]
    foretold: list[Foretold]


def findings(file: MapFile) -> Findings:
    """Read and sum up a map."""
    places, path = file.places(), file.taught_path()
    runs = file.runs()
    repeats = [run for run in runs if run.kind == "repeat"]
    histories = [file.history(place) for place in places]
    plan_m, marks_m = _plan(path, places)
    lives = file.lives()
    first = runs[0].number if runs else 0
    numbers = np.array([run.number for run in repeats], np.int64)
    kept, total = (_alive(lives[chosen], numbers) for chosen in (lives[:, 0] == first, np.ones(len(lives), bool)))
    taught = int(lives[lives[:, 0] == first, 2].sum())
    return Findings(
        plan_m, marks_m, repeats, _seen_share(file, places, repeats), taught, kept, total, _foretold(histories)
    )


def _plan(path: TaughtPath, places: Sequence[Place]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The path from above, computed from the speeds it was taught with."""
    if path.length_m == 0.0:
        return np.zeros((1, 2)), np.zeros((len(places), 2))
    distances_m = np.arange(0.0, path.length_m + _STEP_M, _STEP_M)
    speeds = np.array([path.at(distance_m) for distance_m in distances_m])
    fast = np.where(np.abs(speeds[:, 0]) > 1e-3, np.abs(speeds[:, 0]), np.inf)
    heading = np.pi / 2 + np.concatenate([[0.0], np.cumsum(speeds[:, 1] / fast * _STEP_M)[:-1]])
    ahead_m = np.copysign(_STEP_M, speeds[:, :1])
    steps = ahead_m * np.column_stack([np.cos(heading), np.sin(heading)])
    plan_m = np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)[:-1]])
    marks = [place.distance_m for place in places]
    return plan_m, np.column_stack([np.interp(marks, distances_m, axis) for axis in plan_m.T])


def _alive(lives: NDArray[np.int64], runs: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many features there are after each run."""
    added, removed, counts = lives.T
    there = (added <= runs[:, None]) & ((removed == 0) | (removed > runs[:, None]))
    return np.asarray(there @ counts, np.int64)


def _seen_share(file: MapFile, places: Sequence[Place], runs: Sequence[MapDrive]) -> NDArray[np.float64]:
    rows = {run.number: row for row, run in enumerate(runs)}
    columns = {place.number: column for column, place in enumerate(places)}
    shares = np.full((len(runs), len(places)), np.nan)
    for place, run, share in file.seen_shares():
        if run in rows and place in columns:
            shares[rows[run], columns[place]] = share
    return shares


def _foretold(histories: Sequence[FeatureHistory]) -> list[Foretold]:
    """What was foretold about the last passing of each local map that was passed often enough."""
    enough = [history for history in histories if len(history.times_s) >= LEAST_PASSINGS]
    if not enough:
        return []
    found = []
    for name, learn in MODELS.items():
        scores, seen = [], []
        for history in enough:
            last = history.passed[-1]
            scores.append(learn(history.until(len(history.times_s) - 1))(float(history.times_s[-1]))[last])
            seen.append(history.seen[-1][last])
        found.append(_judged(name, np.concatenate(scores), np.concatenate(seen)))
    return found


def _judged(model: str, scores: NDArray[np.float64], seen: NDArray[np.float64]) -> Foretold:
    probable = bool(len(scores)) and scores.min() >= 0.0 and scores.max() <= 1.0
    bins = np.minimum((scores.clip(0.0, 1.0) * BINS).astype(int), BINS - 1)
    used = np.unique(bins) if probable else np.empty(0, int)
    means = [np.array([values[bins == one].mean() for one in used]) for values in (scores, seen)]
    return Foretold(model, float(((scores - seen) ** 2).mean()) if probable else float("nan"), *means)
