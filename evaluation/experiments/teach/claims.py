"""The claims of Majer et al. 2018 on exposure, and what became of them."""

from __future__ import annotations

from collections.abc import Mapping

from evaluation.experiments.experiment import Claim, Verdict
from evaluation.experiments.teach.cases import FIXED, FULL, STANDARD, Case, Sweep, short
from evaluation.experiments.teach.daylight import REPLAYS
from evaluation.experiments.teach.judge import (
    FOLLOWS_PX,
    FOLLOWS_SHARE,
    SMALL_DIFFERENCE,
    WITHIN_PX,
    Comparison,
    Errors,
    better_everywhere,
    compare,
    follows,
    probability,
)

THEIRS = (STANDARD, FULL, FIXED)


def claims(cases: Mapping[Case, Mapping[str, Errors]], sweeps: Mapping[Case, Sweep]) -> list[Claim]:
    """Those that the cases which were run can be held against."""
    by_light = {
        light: {placement: errors for (of_light, placement), errors in cases.items() if of_light == light}
        for light in REPLAYS
    }
    judged = []
    if by_light["afternoon"]:
        judged += [_better_than(FULL, by_light["afternoon"]), _better_than(FIXED, by_light["afternoon"])]
        judged.append(_small_difference(by_light["afternoon"]))
    if by_light["sunset"]:
        judged.append(_at_sunset(by_light["sunset"]))
    if sweeps:
        judged.append(_darker_is_safer(sweeps))
    return judged


def _better_than(other: str, cases: Mapping[str, Mapping[str, Errors]]) -> Claim:
    """`standard` against another: better where test and interval agree that it is."""
    found = {placement: compare(errors[STANDARD], errors[other]) for placement, errors in cases.items()}
    verdict = better_everywhere([comparison.sign for comparison in found.values()])
    number = len(next(iter(cases.values()))[STANDARD].errors)
    return Claim(
        "MH 4.2, Fig. 7",
        f"Late in the afternoon `standard` has smaller errors than `{short(other)}` (paired t-test over 658 images)",
        "; ".join(f"{placement}: {_told(comparison)}" for placement, comparison in found.items())
        + f"; {number} registrations each",
        verdict,
        _where({placement: comparison.sign for placement, comparison in found.items()}),
    )


def _where(signs: Mapping[str, int]) -> str:
    """In which cases the first was better (-1), worse (1), or neither."""
    words = {-1: "holds", 0: "no difference", 1: "the other way round"}
    return ". ".join(
        f"{word}: {'; '.join(case for case in signs if signs[case] == sign)}"
        for sign, word in words.items()
        if sign in signs.values()
    )


def _small_difference(cases: Mapping[str, Mapping[str, Errors]]) -> Claim:
    """All three curves close to each other at 5 pixels, wherever the sky is."""
    shares = {
        placement: [errors[policy].share_within(WITHIN_PX).value for policy in THEIRS]
        for placement, errors in cases.items()
    }
    small = [max(values) - min(values) <= SMALL_DIFFERENCE for values in shares.values()]
    verdict = Verdict.REPRODUCED if all(small) else Verdict.CONDITIONALLY if any(small) else Verdict.NOT_REPRODUCED
    told = "; ".join(f"{placement}: " + ", ".join(f"{v:.3f}" for v in values) for placement, values in shares.items())
    return Claim(
        "MH 4.2, Fig. 7",
        "The three curves p(error <= x) differ little",
        f"p(error <= {WITHIN_PX:g} px) of `standard`, `full`, `fixed`: {told}",
        verdict,
        f'"little" is {SMALL_DIFFERENCE:g} at {WITHIN_PX:g} px',
    )


def _at_sunset(cases: Mapping[str, Mapping[str, Errors]]) -> Claim:
    """Only `standard` follows the path."""
    good = [[follows(errors[policy]) for policy in THEIRS] for errors in cases.values()]
    claimed = [standard and not full and not fixed for standard, full, fixed in good]
    partly = [standard and not (full and fixed) for standard, full, fixed in good]
    verdict = Verdict.REPRODUCED if all(claimed) else Verdict.CONDITIONALLY if any(partly) else Verdict.NOT_REPRODUCED
    told = "; ".join(
        f"{placement}: " + ", ".join(f"{errors[policy].share_within(FOLLOWS_PX).value:.3f}" for policy in THEIRS)
        for placement, errors in cases.items()
    )
    return Claim(
        "MH 4.2",
        "At sunset the robot could follow its path with `standard`, but neither with `full` nor with `fixed`",
        f"p(error <= {FOLLOWS_PX:g} px) of `standard`, `full`, `fixed`: {told}",
        verdict,
        f"following takes {FOLLOWS_SHARE:.0%} within {FOLLOWS_PX:g} px",
    )


def _told(comparison: Comparison) -> str:
    return f"{comparison.difference.text('+.2f', 'px')}, t = {comparison.t:+.1f}, p {probability(comparison.p)}"


def _darker_is_safer(sweeps: Mapping[Case, Sweep]) -> Claim:
    """One stop below the exposure that holds the top half at 0.5 against one stop above it."""
    found, told = {}, []
    for (light, placement), sweep in sweeps.items():
        below, above = (sweep.errors[list(sweep.offsets).index(offset)] for offset in (-1.0, 1.0))
        name = f"{light}, {placement}"
        found[name] = compare(below, above).sign
        told.append(f"{name}: {below.share_within(WITHIN_PX).value:.2f}, {above.share_within(WITHIN_PX).value:.2f}")
    return Claim(
        "MH 3.2 (after their [45])",
        "Slightly underexposed images are more likely to be registered rightly",
        f"p(error <= {WITHIN_PX:g} px) one stop below and one stop above the exposure of `standard`: {'; '.join(told)}",
        better_everywhere(list(found.values())),
        _where(found),
    )
