"""The verdicts that intervals allow."""

from __future__ import annotations

from collections.abc import Mapping

from evaluation.experiments.experiment import Verdict
from evaluation.intervals import Interval


def below(apart: Interval, margin: float) -> Verdict:
    """On "the first is lower", from first minus second: not so when it is higher, or alike within the margin."""
    if apart.low > 0 or apart.within(margin):
        return Verdict.NOT_REPRODUCED
    return Verdict.REPRODUCED if apart.high < 0 else Verdict.UNDECIDED


def above(apart: Interval, margin: float) -> Verdict:
    """On "the first is higher", likewise."""
    return below(Interval(-apart.value, -apart.high, -apart.low), margin)


def alike(apart: Interval, margin: float) -> Verdict:
    """On "the two hardly differ": so when the whole interval is within the margin, not so when it is beyond."""
    if apart.within(margin):
        return Verdict.REPRODUCED
    return Verdict.NOT_REPRODUCED if apart.low > margin or apart.high < -margin else Verdict.UNDECIDED


def not_above(apart: Interval, margin: float) -> Verdict:
    """On "the first is at most `margin` higher"."""
    if apart.high <= margin:
        return Verdict.REPRODUCED
    return Verdict.NOT_REPRODUCED if apart.low > margin else Verdict.UNDECIDED


def together(parts: Mapping[str, Verdict]) -> tuple[Verdict, str]:
    """The verdict on a claim of several parts, and the condition: which of them hold, and which are undecided.
    Conditionally when some hold; if none does, not reproduced as soon as one part is not."""
    held, undecided = (
        [name for name, verdict in parts.items() if verdict is which]
        for which in (Verdict.REPRODUCED, Verdict.UNDECIDED)
    )
    if len(held) == len(parts):
        return Verdict.REPRODUCED, ""
    if not held:
        return (Verdict.UNDECIDED if len(undecided) == len(parts) else Verdict.NOT_REPRODUCED), ""
    doubt = f"; undecided: {', '.join(undecided)}" if undecided else ""
    return Verdict.CONDITIONALLY, f"holds: {', '.join(held)}{doubt}"
