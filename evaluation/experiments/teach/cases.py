"""The cases compared (lights and placements of the sky), and the results of each over all parks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.experiment import Results
from evaluation.experiments.teach.daylight import REPLAYS
from evaluation.experiments.teach.judge import Errors
from evaluation.experiments.teach.replay import POLICIES, WAYS

STANDARD, FULL, FIXED = POLICIES[:3]

TILTS = {"in the upper half": 0.0, "beyond it": 12.0, "hardly seen": -14.0}
"""Where the sky is, by the upward tilt of the camera (degrees): level; raised, so that the sky reaches into the lower
half; and lowered, so that the view ends in the trees."""

AS_PAPER = next(iter(WAYS))

Case = tuple[str, str]
"""Light and placement."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One view near each map at several exposures.

    Attributes
    ----------
    offsets
        Stops from the exposure that holds the top half at 0.5, shape (offsets,).
    errors
        By offset.
    votes
        Shape (maps, offsets).
    whole
        Offset at which the whole image has a mean of 0.5, shape (maps,).
    """

    offsets: NDArray[np.float64]
    errors: tuple[Errors, ...]
    votes: NDArray[np.int64]
    whole: NDArray[np.float64]


def replays_of(results: Results, light: str, tilt_deg: float | None = None) -> list[Any]:
    """Results of `replay.measure` in a light, with one tilt or with all."""
    return [
        result
        for arguments, result in results
        if "looks" in result and arguments["light"] == light and tilt_deg in (None, arguments["tilt_deg"])
    ]


def cases_of(results: Results, way: str = AS_PAPER) -> dict[Case, dict[str, Errors]]:
    """Errors by policy for each case that was run."""
    return {
        (light, placement): {policy: errors_of(replays, way, policy) for policy in POLICIES}
        for light in REPLAYS
        for placement, tilt in TILTS.items()
        if (replays := replays_of(results, light, tilt))
    }


def errors_of(replays: list[Any], way: str, policy: str) -> Errors:
    """One policy's errors over several replays; registrations without a true shift are omitted for all policies."""
    errors: list[NDArray[np.float64]] = []
    places: list[NDArray[np.int64]] = []
    first = 0
    for replay in replays:
        truth, maps = np.array(replay["shift"]), np.array(replay["map"], np.int64)
        known = ~np.isnan(truth)
        errors.append(np.abs(_or_infinite(replay["shifts"][way][policy]) - truth)[known])
        places.append(first + maps[known])
        first += int(maps.max()) + 1
    return Errors(np.concatenate(errors), np.concatenate(places))


def sweeps_of(results: Results) -> dict[Case, Sweep]:
    """The sweep of each case that was run."""
    sweeps = {}
    for light in REPLAYS:
        for placement, tilt in TILTS.items():
            found = [
                result
                for arguments, result in results
                if "offsets" in result and (arguments["light"], arguments["tilt_deg"]) == (light, tilt)
            ]
            if found:
                sweeps[light, placement] = _joined(found)
    return sweeps


def name(case: Case) -> str:
    """A case, for people to read."""
    return f"{case[0]}, sky {case[1]}"


def short(policy: str) -> str:
    """The paper's name for a policy."""
    return policy.removeprefix("majer2018-")


def _joined(found: list[Any]) -> Sweep:
    errors = np.concatenate([[_or_infinite(row) for row in one["errors"]] for one in found])
    known = ~np.isnan(errors[:, 0])
    places = np.arange(int(known.sum()))
    return Sweep(
        np.array(found[0]["offsets"], np.float64),
        tuple(Errors(column[known], places) for column in errors.T),
        np.concatenate([one["votes"] for one in found]),
        np.concatenate([one["whole"] for one in found]),
    )


def _or_infinite(values: list[Any]) -> NDArray[np.float64]:
    return np.array([math.inf if value is None else value for value in values], np.float64)
