"""Mutation testing: ``python -m tests.mutation``; ``make mutate`` runs it.

Changes the code one thing at a time, in a copy, and runs the tests that touch what was changed: a mutant that no test
notices survives. `MUTANTS` of them (200) are drawn with `SEED` (1). What is known stays in build/mutation, and
the next run goes on from it: a kill stands as long as the file and the test that noticed stay as they are.
"""

from __future__ import annotations

import os
import queue
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import TypeVar

from tests.mutation.accepted import ACCEPTED
from tests.mutation.relevance import CHUNK, Relevance, related
from tests.mutation.scope import Mutant, generated, sample, sources
from tests.mutation.trial import DisturbedError, Fate, Log, judge
from tests.mutation.workplace import Workplace

PROJECT = Path(__file__).parents[2]
BUILD = PROJECT / "build/mutation"
AT_ONCE = 2
MOST_SURVIVORS = 0.1
"""Of all mutants, explained or not."""

WIDEST = 90
Outcomes = dict[Mutant, Fate]
Task = TypeVar("Task")
Result = TypeVar("Result")


class Bench:
    """Copies of the project, one for each thing done at once."""

    def __init__(self, folder: Path) -> None:
        self._places = [Workplace(PROJECT, folder / str(number)) for number in range(AT_ONCE)]
        self._free: queue.SimpleQueue[Workplace] = queue.SimpleQueue()
        for place in self._places:
            self._free.put(place)

    def do(self, tasks: Iterable[Task], work: Callable[[Workplace, Task], Result]) -> Iterator[tuple[Task, Result]]:
        """Work on the tasks, some at once; what comes of each, as they are done."""

        def one(task: Task) -> tuple[Task, Result]:
            place = self._free.get()
            try:
                return task, work(place, task)
            finally:
                self._free.put(place)

        with ThreadPoolExecutor(AT_ONCE) as executor:
            try:
                for done in as_completed([executor.submit(one, task) for task in tasks]):
                    yield done.result()
            except BaseException:
                executor.shutdown(wait=False, cancel_futures=True)
                for place in self._places:
                    place.stop()
                raise


def main() -> int:
    """Draw the mutants, try them, say what became of them."""
    count, seed = whole_number("MUTANTS", 200), whole_number("SEED", 1)
    BUILD.mkdir(parents=True, exist_ok=True)
    texts = sources(PROJECT)
    relevance = Relevance(PROJECT, texts, BUILD / "tests.json")
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        bench = Bench(Path(folder))
        trace(bench, relevance)
        outcomes = try_all(bench, relevance, sample(texts, count, seed))
    print(summary(outcomes))
    for name in ACCEPTED.keys() - {mutant.name for mutant in generated(texts)}:
        print(f"explained in tests/mutation/accepted.py, but gone from the code: {name}")
    wrong = complaint(outcomes)
    if wrong:
        print(wrong, file=sys.stderr)
    return 1 if wrong else 0


def whole_number(variable: str, usual: int) -> int:
    """What a variable of the environment says."""
    text = os.environ.get(variable, "")
    if text and not text.isdecimal():
        sys.exit(f"{variable} is {text!r}: give a whole number, or leave it out for {usual}")
    return int(text) if text else usual


def trace(bench: Bench, relevance: Relevance) -> None:
    """Learn what the tests run, where this is not known."""
    files = relevance.untraced
    if not files:
        return
    print(f"which test runs what: {len(files)} files of tests under coverage", flush=True)
    parts = -(-len(files) // CHUNK)
    chunks = [tuple(files[part::parts]) for part in range(parts)]
    for number, (chunk, failed) in enumerate(bench.do(chunks, relevance.trace), 1):
        relevance.keep()
        print(f"  part {number} of {parts}: {len(chunk)} files", flush=True)
        for test in failed:
            print(f"  fails without any change, and is left out: {test}", flush=True)


def try_all(bench: Bench, relevance: Relevance, mutants: list[Mutant]) -> Outcomes:
    """What becomes of each mutant; those known from before are not tried again."""
    log, tests = Log(BUILD / "fates.json", relevance), relevance.tests()
    fates = {mutant: fate for mutant in mutants if (fate := log.known(mutant))}
    print(f"{len(mutants)} mutants, {len(fates)} of them known from before; {len(tests)} tests", flush=True)

    def find(place: Workplace, mutant: Mutant) -> Fate:
        return judge(place, mutant, related(mutant, relevance, tests))

    for mutant, fate in bench.do([mutant for mutant in mutants if mutant not in fates], find):
        fates[mutant] = fate
        log.add(mutant, fate)
        print(f"{len(fates):4}/{len(mutants)} {row(mutant, fate)}", flush=True)
    return {mutant: fates[mutant] for mutant in mutants}


def row(mutant: Mutant, fate: Fate) -> str:
    """A mutant on one line."""
    test = f"  by {fate.by}" if fate.by else f"  unnoticed by {fate.tests} tests"
    change = f"{mutant.change.before} -> {mutant.change.after}"
    where = f"{mutant.path}:{mutant.change.line}"
    return f"{fate.kind:8} {fate.seconds:5.1f} s  {where}  {_short(change)}{test}"


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


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        sys.exit(main())
    except DisturbedError as error:
        sys.exit(f"{error}; the next run goes on from here")
    except KeyboardInterrupt:
        sys.exit("stopped; the next run goes on from here")
