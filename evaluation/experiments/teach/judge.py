"""From registrations to error curves, paired tests, and verdicts on the claims of Majer et al. 2018."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evaluation.arrays import Floats, Ints
from evaluation.experiments.experiment import Claim, Results, Verdict
from evaluation.experiments.teach.park import REPLAYS, STEADY
from evaluation.experiments.teach.replay import POLICIES, WAYS
from evaluation.intervals import Interval

LOST_PX = 50.0  # In means and tests, larger errors and failures count as this: a robot cannot be more than lost
WITHIN_PX = 5.0  # Where the curves are compared
SMALL_DIFFERENCE = 0.1  # What counts as "only a small difference" between two curves at 5 pixels
SIGNIFICANT = 0.05
# A robot can follow its path if this share of registrations is within this error, two thirds of a degree.
FOLLOWS_PX, FOLLOWS_SHARE = 10.0, 0.9
_DRAWS = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Registration errors of one policy, in the same order for all policies of a case."""

    errors: Floats  # in pixels, infinite where no shift was found, float64, (registrations,)
    # The local map of each, numbered from 0 over all parks, int64. Registrations with one map are alike, so bootstraps
    # draw maps, not registrations.
    places: Ints

    @property
    def capped(self) -> Floats:
        """Errors capped at `LOST_PX`."""
        return np.minimum(self.errors, LOST_PX)

    @property
    def failures(self) -> int:
        """How many registrations found no shift."""
        return int(np.isinf(self.errors).sum())

    def share_within(self, pixels: float) -> Interval:
        """p(error <= pixels) with its interval."""
        return _interval((self.errors <= pixels).astype(np.float64), self.places)

    def curve(self, pixels: Floats) -> Floats:
        """p(error <= x) and the lower and upper end of its 95 % band, shape (3, len(pixels))."""
        within = (self.errors[:, None] <= pixels).astype(np.float64)
        low, high = np.percentile(_drawn_means(within, self.places), [2.5, 97.5], axis=0)
        return np.stack([within.mean(axis=0), low, high])


@dataclass(frozen=True, slots=True)
class PairedComparison:
    """Errors of one policy minus those of another, image by image."""

    difference: Interval  # mean difference (pixels), below 0 where the first is better, with its interval over maps
    # t, p: student's paired test over registrations, two-sided; it takes them as independent, as the paper does.
    t: float
    p: float

    @property
    def sign(self) -> int:
        """-1: the first is better, 1: it is worse, each by both test and interval; otherwise 0."""
        if self.p >= SIGNIFICANT or self.difference.low <= 0 <= self.difference.high:
            return 0
        return 1 if self.difference.value > 0 else -1


def compare(first: Errors, second: Errors) -> PairedComparison:
    """Whether the first registers better than the second."""
    difference = first.capped - second.capped
    t, p = paired_t(difference)
    return PairedComparison(_interval(difference, first.places), t, p)


def paired_t(differences: Floats) -> tuple[float, float]:
    """Student's t of hundreds of paired differences and its two-sided probability, by the normal approximation."""
    spread = float(differences.std(ddof=1))
    if spread == 0:
        return 0.0, 1.0
    t = float(differences.mean()) / (spread / math.sqrt(len(differences)))
    return t, math.erfc(abs(t) / math.sqrt(2.0))


def better_everywhere(signs: Sequence[int]) -> Verdict:
    """The verdict on "is better": in all cases, in some, or in none."""
    if signs and all(sign < 0 for sign in signs):
        return Verdict.REPRODUCED
    return Verdict.CONDITIONALLY if any(sign < 0 for sign in signs) else Verdict.NOT_REPRODUCED


def probability(p: float) -> str:
    """For people to read."""
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"


def follows(errors: Errors) -> bool:
    """Whether a robot could follow its path with these registrations."""
    return bool((errors.errors <= FOLLOWS_PX).mean() >= FOLLOWS_SHARE)


def _interval(values: Floats, places: Ints) -> Interval:
    low, high = np.percentile(_drawn_means(values[:, None], places), [2.5, 97.5])
    return Interval(float(values.mean()), float(low), float(high))


def _drawn_means(values: Floats, places: Ints) -> Floats:
    """Means of columns over maps drawn with replacement, shape (draws, columns)."""
    _, groups, sizes = np.unique(places, return_inverse=True, return_counts=True)
    sums = np.zeros((len(sizes), values.shape[1]))
    np.add.at(sums, groups, values)
    drawn = np.random.default_rng(0).multinomial(len(sizes), np.full(len(sizes), 1 / len(sizes)), _DRAWS)
    return np.asarray((drawn @ sums) / (drawn @ sizes)[:, None])


STANDARD, FULL, FIXED = POLICIES[:3]
# Where the sky is, by the upward tilt of the camera (degrees): level; raised, so that the sky reaches into the lower
# half; and lowered, so that the view ends in the trees.
TILTS = {"in the upper half": 0.0, "beyond it": 12.0, "hardly seen": -14.0}
AS_PAPER = next(iter(WAYS))
Case = tuple[str, str]  # Light and placement


@dataclass(frozen=True, slots=True, eq=False)
class ExposureSweep:
    """One view near each map at several exposures."""

    offsets: Floats  # stops from the exposure that holds the top half at 0.5, shape (offsets,)
    errors: tuple[Errors, ...]  # by offset
    votes: Ints  # shape (maps, offsets)
    whole: Floats  # offset at which the whole image has a mean of 0.5, shape (maps,)


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
    errors: list[Floats] = []
    places: list[Ints] = []
    first = 0
    for replay in replays:
        truth, maps = np.array(replay["shift"]), np.array(replay["map"], np.int64)
        known = ~np.isnan(truth)
        errors.append(np.abs(_or_infinite(replay["shifts"][way][policy]) - truth)[known])
        places.append(first + maps[known])
        first += int(maps.max()) + 1
    return Errors(np.concatenate(errors), np.concatenate(places))


def sweeps_of(results: Results) -> dict[Case, ExposureSweep]:
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


def _joined(found: list[Any]) -> ExposureSweep:
    errors = np.concatenate([[_or_infinite(row) for row in one["errors"]] for one in found])
    known = ~np.isnan(errors[:, 0])
    places = np.arange(int(known.sum()))
    return ExposureSweep(
        np.array(found[0]["offsets"], np.float64),
        tuple(Errors(column[known], places) for column in errors.T),
        np.concatenate([one["votes"] for one in found]),
        np.concatenate([one["whole"] for one in found]),
    )


def _or_infinite(values: list[Any]) -> Floats:
    return np.array([math.inf if value is None else value for value in values], np.float64)


THEIRS = (STANDARD, FULL, FIXED)


def claims(cases: Mapping[Case, Mapping[str, Errors]], sweeps: Mapping[Case, ExposureSweep]) -> list[Claim]:
    """Judge the claims that the cases which were run are about."""
    steady = {case: errors for case, errors in cases.items() if case[0] in STEADY}
    sunset = {case: errors for case, errors in cases.items() if case[0] not in STEADY}
    judged = []
    if steady:
        judged += [_better_than(FULL, steady), _better_than(FIXED, steady), _small_difference(steady)]
    if sunset:
        judged.append(_at_sunset(sunset))
    if sweeps:
        judged.append(_darker_is_safer(sweeps))
    return judged


def _better_than(other: str, cases: Mapping[Case, Mapping[str, Errors]]) -> Claim:
    """`standard` against another policy: better where test and interval agree."""
    found = {case: compare(errors[STANDARD], errors[other]) for case, errors in cases.items()}
    verdict = better_everywhere([comparison.sign for comparison in found.values()])
    number = len(next(iter(cases.values()))[STANDARD].errors)
    return Claim(
        "MH 4.2, Fig. 7",
        f"Late in the afternoon `standard` has smaller errors than `{short(other)}` (paired t-test over 658 images)",
        "difference of mean errors, px: "
        + _by_light({case: comparison.difference.text("+.2f") for case, comparison in found.items()})
        + f"; {number} registrations each",
        verdict,
        _where({case: comparison.sign for case, comparison in found.items()}),
    )


def _where(signs: Mapping[Case, int]) -> str:
    """In which cases the first policy was better (-1), worse (1), or neither (0)."""
    words = {-1: "holds", 0: "no difference", 1: "the other way round"}
    parts = []
    for sign, word in words.items():
        cases = [case for case in signs if signs[case] == sign]
        lights = dict.fromkeys(light for light, _ in cases)
        places = (f"{light} ({', '.join(place for of, place in cases if of == light)})" for light in lights)
        if cases:
            parts.append(f"{word}: {', '.join(places)}")
    return "; ".join(parts)


def _by_light(texts: Mapping[Case, str]) -> str:
    """A text about each case, grouped by light."""
    lights = dict.fromkeys(light for light, _ in texts)
    return "; ".join(
        f"{light}: " + ", ".join(f"sky {place} {text}" for (of, place), text in texts.items() if of == light)
        for light in lights
    )


def _small_difference(cases: Mapping[Case, Mapping[str, Errors]]) -> Claim:
    """Reproduced when all three curves are close to each other at 5 pixels in every case."""
    shares = {
        case: [errors[policy].share_within(WITHIN_PX).value for policy in THEIRS] for case, errors in cases.items()
    }
    small = [max(values) - min(values) <= SMALL_DIFFERENCE for values in shares.values()]
    verdict = Verdict.REPRODUCED if all(small) else Verdict.CONDITIONALLY if any(small) else Verdict.NOT_REPRODUCED
    numbers = _by_light({case: " / ".join(f"{value:.3f}" for value in values) for case, values in shares.items()})
    return Claim(
        "MH 4.2, Fig. 7",
        "The three curves p(error <= x) differ little",
        f"p(error <= {WITHIN_PX:g} px) of `standard` / `full` / `fixed`: {numbers}",
        verdict,
        f'"little" is {SMALL_DIFFERENCE:g} at {WITHIN_PX:g} px',
    )


def _at_sunset(cases: Mapping[Case, Mapping[str, Errors]]) -> Claim:
    """Reproduced when only `standard` follows the path."""
    good = [[follows(errors[policy]) for policy in THEIRS] for errors in cases.values()]
    claimed = [standard and not full and not fixed for standard, full, fixed in good]
    partly = [standard and not (full and fixed) for standard, full, fixed in good]
    verdict = Verdict.REPRODUCED if all(claimed) else Verdict.CONDITIONALLY if any(partly) else Verdict.NOT_REPRODUCED
    numbers = _by_light(
        {
            case: " / ".join(f"{errors[policy].share_within(FOLLOWS_PX).value:.3f}" for policy in THEIRS)
            for case, errors in cases.items()
        }
    )
    return Claim(
        "MH 4.2",
        "At sunset the robot could follow its path with `standard`, but neither with `full` nor with `fixed`",
        f"p(error <= {FOLLOWS_PX:g} px) of `standard` / `full` / `fixed`: {numbers}",
        verdict,
        f"following requires {FOLLOWS_SHARE:.0%} within {FOLLOWS_PX:g} px",
    )


def _darker_is_safer(sweeps: Mapping[Case, ExposureSweep]) -> Claim:
    """Compares one stop below the exposure that holds the top half at 0.5 with one stop above it."""
    signs, numbers = {}, {}
    for case, sweep in sweeps.items():
        below, above = (sweep.errors[list(sweep.offsets).index(offset)] for offset in (-1.0, 1.0))
        signs[case] = compare(below, above).sign
        numbers[case] = f"{below.share_within(WITHIN_PX).value:.2f} / {above.share_within(WITHIN_PX).value:.2f}"
    return Claim(
        "MH 3.2 (after their [45])",
        "Slightly underexposed images are more likely to be registered correctly",
        f"p(error <= {WITHIN_PX:g} px) one stop below / above the exposure of `standard`: {_by_light(numbers)}",
        better_everywhere(list(signs.values())),
        _where(signs),
    )
