"""The table of mutants and what it comes to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from tests.mutation.accepted import ACCEPTED
from tests.mutation.scope import Mutant
from tests.mutation.trial import Fate

MOST_SURVIVORS = 0.1
"""Of all mutants, explained or not."""

WIDEST = 90
Outcomes = dict[Mutant, Fate]


def row(mutant: Mutant, fate: Fate) -> str:
    """A mutant on one line."""
    test = f"  by {fate.by}" if fate.by else f"  unnoticed by {fate.tests} tests"
    change = f"{mutant.change.before} -> {mutant.change.after}"
    where = f"{mutant.path}:{mutant.change.line}"
    return f"{fate.kind:8} {fate.seconds:5.1f} s  {where}  {_short(change)}{test}"


def table(outcomes: Outcomes) -> str:
    """All mutants in Markdown, the listed ones first."""
    lines = ["| mutant | | by |", "|---|---|---|"]
    for mutant, fate in outcomes.items():
        change = f"`{_short(mutant.change.before)}` -> `{_short(mutant.change.after)}`".replace("|", "\\|")
        lines.append(f"| {mutant.path}:{mutant.change.line} {change} | {fate.kind} | {fate.by or ''} |")
    return "\n".join([summary(outcomes), "", *lines, ""])


def summary(outcomes: Outcomes) -> str:
    """Totals by package, and the survivors."""
    lines = ["| package | mutants | killed | time-out | survived | explained |", "|---|---|---|---|---|---|"]
    packages = dict.fromkeys(mutant.package for mutant in outcomes)
    for package in (*packages, "all"):
        lines.append(_totals(package, [item for item in outcomes.items() if package in (item[0].package, "all")]))
    survivors = _survivors(outcomes)
    lines += ["", f"{len(survivors)} survived:" if survivors else "No mutant survived."]
    for mutant in survivors:
        lines.append(f"* {mutant.name}\n  {ACCEPTED.get(mutant.name, 'NOT EXPLAINED')}")
    return "\n".join(lines)


def complaint(outcomes: Outcomes) -> str | None:
    """What is wrong with the tests, in a sentence; None: nothing."""
    survivors = _survivors(outcomes)
    unexplained = [mutant for mutant in survivors if mutant.name not in ACCEPTED]
    if unexplained:
        return (
            f"{len(unexplained)} mutants survive without an explanation: add a test that notices them, or say in "
            "tests/mutation/accepted.py why they may live"
        )
    if len(survivors) > MOST_SURVIVORS * len(outcomes):
        return f"{len(survivors)} of {len(outcomes)} mutants survive, more than one in ten: add tests that notice them"
    return None


def _survivors(outcomes: Outcomes) -> list[Mutant]:
    return [mutant for mutant, fate in outcomes.items() if fate.kind == "survived"]


def _totals(package: str, outcomes: Iterable[tuple[Mutant, Fate]]) -> str:
    fates = list(outcomes)
    kinds = Counter(fate.kind for _, fate in fates)
    explained = sum(fate.kind == "survived" and mutant.name in ACCEPTED for mutant, fate in fates)
    return f"| {package} | {len(fates)} | {kinds['killed']} | {kinds['time-out']} | {kinds['survived']} | {explained} |"


def _short(text: str) -> str:
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 4]} ..."
