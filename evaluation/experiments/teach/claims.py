"""The claims of Majer et al. 2018 on exposure, judged."""

from __future__ import annotations

from collections.abc import Mapping

from evaluation.experiments.experiment import Claim, Verdict
from evaluation.experiments.teach.cases import FIXED, FULL, STANDARD, Case, Sweep, short
from evaluation.experiments.teach.daylight import STEADY
from evaluation.experiments.teach.judge import (
    FOLLOWS_PX,
    FOLLOWS_SHARE,
    SMALL_DIFFERENCE,
    WITHIN_PX,
    Errors,
    better_everywhere,
    compare,
    follows,
)

THEIRS = (STANDARD, FULL, FIXED)


def claims(cases: Mapping[Case, Mapping[str, Errors]], sweeps: Mapping[Case, Sweep]) -> list[Claim]:
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


def _darker_is_safer(sweeps: Mapping[Case, Sweep]) -> Claim:
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
