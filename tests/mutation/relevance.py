"""Which tests run the code of a mutant: found by running them all once under coverage.

A function is run by a test, or not; what is outside of functions is felt by those that use its names.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from tests.mutation.scope import Mutant
from tests.mutation.workplace import Workplace

Function = ast.FunctionDef
Place = str
"""A function: ``path:Class.name``."""


def function_lines(source: str) -> dict[int, str]:
    """By line in the body of a function, the function's name; the innermost one. Other lines run at import."""
    lines: dict[int, str] = {}
    for name, node in _functions(ast.parse(source)):
        for line in range(node.body[0].lineno, (node.end_lineno or node.lineno) + 1):
            lines[line] = name
    return lines


def function_at(source: str, line: int) -> str | None:
    """The function that a line is in, its signature included; None outside of all."""
    found = None
    for name, node in _functions(ast.parse(source)):
        if node.lineno <= line <= (node.end_lineno or node.lineno):
            found = name
    return found


def users(sources: Mapping[str, str], path: str, line: int) -> set[Place]:
    """The functions that use, by name, what the module-level statement at a line defines. `sources`: text by path.

    Names defined from it count as well; a name imported elsewhere is followed there. Of a class all methods do.
    """
    tree = ast.parse(sources[path])
    statement = next(s for s in tree.body if s.lineno <= line <= (s.end_lineno or s.lineno))
    names = _closure(tree, _defined(statement))
    found = _mentions(path, tree, names)
    module = Path(path).with_suffix("").as_posix().replace("/", ".")
    for other, text in sources.items():
        if other == path or module not in text:
            continue
        other_tree = ast.parse(text)
        imported = {
            alias.asname or alias.name
            for node in ast.walk(other_tree)
            if isinstance(node, ast.ImportFrom) and node.module == module
            for alias in node.names
            if alias.name in names
        }
        if imported:
            found |= _mentions(other, other_tree, _closure(other_tree, imported))
    return found


def _functions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, Function]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, Function):
            yield f"{prefix}{node.name}", node
            yield from _functions(node, f"{prefix}{node.name}.")
        elif isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{prefix}{node.name}.")
        else:
            yield from _functions(node, prefix)


def _defined(statement: ast.stmt) -> set[str]:
    """Names that a statement outside of functions gives a value to."""
    if isinstance(statement, ast.ClassDef):
        return {statement.name}
    targets = [node for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    return {target.id for target in targets}


def _closure(tree: ast.Module, names: set[str]) -> set[str]:
    """With what other module-level statements make of the names."""
    names = set(names)
    while True:
        more = {
            defined
            for statement in tree.body
            if _mentioned_at_import(statement) & names
            for defined in _defined(statement)
        }
        if more <= names:
            return names
        names |= more


def _mentions(path: str, tree: ast.Module, names: set[str]) -> set[Place]:
    """Functions in whose text one of the names stands, and the methods of the classes among the names."""
    found = {f"{path}:{name}" for name, node in _functions(tree) if _mentioned(node) & names}
    classes = {node.name for node in tree.body if isinstance(node, ast.ClassDef)} & names
    return found | {f"{path}:{name}" for name, _ in _functions(tree) if name.split(".")[0] in classes}


def _mentioned_at_import(statement: ast.stmt) -> set[str]:
    if isinstance(statement, ast.FunctionDef):
        return set()
    if isinstance(statement, ast.ClassDef):
        return set().union(*map(_mentioned_at_import, statement.body))
    return _mentioned(statement)


def _mentioned(node: ast.AST) -> set[str]:
    return {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}


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
    """The tests of a project and what they run of its sources, kept in a file while the code stays as it is."""

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
