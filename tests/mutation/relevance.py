"""Which tests run the code of a mutant: found by running them all once under coverage."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from tests.mutation.functions import function_at, users
from tests.mutation.scope import Mutant
from tests.mutation.workplace import Workplace

NOT_RELATED = ("accept", "kernel", "fake_camera", "systemd", "page", "publish", "mutation")
"""Folders of tests about other things, or in real time."""

MARKS = "not realtime"
CHUNK = 12
"""Test files that one process runs."""

CHUNK_TIMEOUT_S = 1800.0
BUDGET_S = 45.0
"""Of tests for one mutant, the quickest first, as long as they took under coverage."""


@dataclass(frozen=True, slots=True)
class Traced:
    """A test that was traced: where it is, how long it takes, which functions it runs."""

    name: str
    seconds: float
    functions: frozenset[str]

    @property
    def file(self) -> str:
        """The file it is in."""
        return self.name.split("::")[0]

    @property
    def place(self) -> str:
        """Its own function, as the others are named."""
        function = ".".join(self.name.split("::")[1:]).split("[")[0]
        return f"{self.file}:{function}"


class Relevance:
    """The tests and what they run, kept in a file for as long as the code stays as it is.

    Parameters
    ----------
    root
        The project.
    texts
        Its sources.
    kept
        Where the knowledge is kept.
    """

    def __init__(self, root: Path, texts: Mapping[str, str], kept: Path) -> None:
        self._texts, self._kept = texts, kept
        files = {file.relative_to(root).as_posix(): file.read_text() for file in sorted((root / "tests").rglob("*.py"))}
        self.test_files = {
            path: text
            for path, text in files.items()
            if Path(path).name.startswith("test_") and Path(path).parts[1] not in NOT_RELATED
        }
        helpers = {path: text for path, text in files.items() if path not in self.test_files and "mutation" not in path}
        self._world = digest([*texts.values(), *helpers.values()])
        known: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
        self._known = {path: entry for path, entry in known.items() if entry["digest"] == self._digest(path)}

    @property
    def untraced(self) -> list[str]:
        """Test files of which it is not known what they run."""
        return [path for path in self.test_files if path not in self._known]

    def trace(self, workplace: Workplace, chunk: Sequence[str]) -> list[str]:
        """Run some test files and keep what they run; returns the tests that fail as things are."""
        out = workplace.root / "trace.json"
        out.unlink(missing_ok=True)
        options = ["-p", "tests.mutation.tracing", "-m", MARKS]
        ended = workplace.pytest([*options, *chunk], CHUNK_TIMEOUT_S, {"MUTATION_TRACE": str(out)})
        if not out.exists():
            raise RuntimeError(f"the tests could not be traced: {ended.output[-2000:]}")
        tests = json.loads(out.read_text())
        for path in chunk:
            own = {name: test for name, test in tests.items() if name.split("::")[0] == path}
            self._known[path] = {"digest": self._digest(path), "tests": own}
        return ended.all_failed

    def keep(self) -> None:
        """Write down what is known."""
        self._kept.write_text(json.dumps(self._known))

    def tests(self) -> list[Traced]:
        """All tests that pass, the quickest first."""
        found = [
            Traced(name, test["seconds"], frozenset(test["functions"]))
            for path, entry in self._known.items()
            if path in self.test_files
            for name, test in entry["tests"].items()
        ]
        return sorted(found, key=lambda test: (test.seconds, test.name))

    def places(self, mutant: Mutant) -> set[str]:
        """The functions in which a mutant makes itself felt."""
        function = function_at(mutant.text, mutant.change.line)
        if function is not None:
            return {f"{mutant.path}:{function}"}
        return users({**self._texts, **self.test_files}, mutant.path, mutant.change.line)

    def digest_of(self, test: str | None) -> str:
        """Of the file of a test, or of all that tests may rest on."""
        if test is not None and (text := self.test_files.get(test.split("::")[0])):
            return digest([text])
        return digest([self._world, *self.test_files.values()])

    def _digest(self, path: str) -> str:
        return digest([self._world, self.test_files.get(path, "")])


def related(mutant: Mutant, relevance: Relevance, tests: Sequence[Traced]) -> list[Traced]:
    """The tests that run a mutant, quickest first, within the budget; and those of a file named after the mutated one.

    Coverage does not see what a test has another process do.
    """
    places = relevance.places(mutant)
    touching = [test for test in tests if test.functions & places or test.place in places]
    if not touching and function_at(mutant.text, mutant.change.line) is None:
        touching = [test for test in tests if any(name.startswith(f"{mutant.path}:") for name in test.functions)]
    namesake = f"test_{Path(mutant.path).stem}"
    touching += [test for test in tests if Path(test.file).stem == namesake and test not in touching]
    chosen: list[Traced] = []
    seconds = 0.0
    for test in touching:
        seconds += test.seconds
        if seconds > BUDGET_S and chosen:
            break
        chosen.append(test)
    return chosen


def digest(texts: Iterable[str]) -> str:
    """A short name of some texts."""
    return sha256("\0".join(texts).encode()).hexdigest()[:16]
