"""What becomes of a mutant, and what is remembered of it."""

from __future__ import annotations

import json
import signal
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.mutation.relevance import Relevance, Traced, digest
from tests.mutation.scope import Mutant
from tests.mutation.workplace import Ended, Workplace

LEAST_TIMEOUT_S, SLOWER = 40.0, 8.0
"""A test gets so many times as long as it took under coverage, and this long at least: machines are shared."""

NOT_FOUND = 4
"""Exit status of pytest when tests asked for by name are not there: their parameters hang on what was mutated."""


FROM_OUTSIDE = (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP)
"""Ends of pytest that say nothing of the mutant; what it breaks ends in a failure or a fault."""


class DisturbedError(Exception):
    """The tests of a mutant were ended by something else."""


@dataclass(frozen=True, slots=True)
class Fate:
    """What became of a mutant."""

    kind: str  # killed, time-out or survived
    by: str | None  # the test that noticed; None of a survivor
    tests: int  # how many were to be run
    seconds: float


def judge(place: Workplace, mutant: Mutant, tests: list[Traced]) -> Fate:
    """Let the tests look for the mutant, until one notices it; DisturbedError where they are not let to end."""
    began_s = time.monotonic()
    kind, by = ("survived", None) if not tests else _noticed(place, mutant, tests)
    return Fate(kind, by, len(tests), round(time.monotonic() - began_s, 1))


def _noticed(place: Workplace, mutant: Mutant, tests: list[Traced]) -> tuple[str, str | None]:
    files = list(dict.fromkeys(test.file for test in tests))
    names = [test.name for file in files for test in tests if test.file == file]
    test_timeout_s = max(SLOWER * max(test.seconds for test in tests), LEAST_TIMEOUT_S)
    timeout_s = test_timeout_s + SLOWER * sum(test.seconds for test in tests)
    options = ["-x", f"--timeout={test_timeout_s:.0f}"]
    with place.holding(mutant.path, mutant.mutated):
        ended = place.pytest([*options, *names], timeout_s)
        if ended.status == NOT_FOUND:
            ended = place.pytest([*options, *files], timeout_s)
    if ended.status in FROM_OUTSIDE:
        raise DisturbedError(f"something else ended the tests of {mutant.name}: nothing is concluded of it")
    return _kind(ended), None if ended.status == 0 else ended.failed or names[0]


def _kind(ended: Ended) -> str:
    if ended.status == 0:
        return "survived"
    return "time-out" if ended.status is None or "from pytest-timeout" in ended.output else "killed"


class Log:
    """Fates by mutant, in a file. A kill stands as long as the mutated file and that of the test stay as they are.

    A survivor is tried again when any test has changed.
    """

    def __init__(self, file: Path, relevance: Relevance) -> None:
        self._file, self._relevance = file, relevance
        self._entries: dict[str, dict[str, Any]] = json.loads(file.read_text()) if file.exists() else {}

    def known(self, mutant: Mutant) -> Fate | None:
        """What became of a mutant before, if it would become the same of it now."""
        entry = self._entries.get(mutant.name)
        if entry is None or entry["rests_on"] != self._rests_on(mutant, entry["by"]):
            return None
        return Fate(entry["kind"], entry["by"], entry["tests"], entry["seconds"])

    def add(self, mutant: Mutant, fate: Fate) -> None:
        """Remember."""
        self._entries[mutant.name] = asdict(fate) | {"rests_on": self._rests_on(mutant, fate.by)}
        self._file.write_text(json.dumps(self._entries, indent=1))

    def _rests_on(self, mutant: Mutant, by: str | None) -> str:
        return digest([mutant.text, self._relevance.digest_of(by)])
