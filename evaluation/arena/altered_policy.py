"""A policy with one of its constants altered, in a process of its own, started with `python -m`.

The module's source is altered before it is compiled, and before any module of control is imported. So everything that
follows from the constant is altered with it: copies by `from ... import`, arrays and defaults of arguments made of it.
That is why this file imports no more than the standard library and errors until then."""

from __future__ import annotations

import ast
import json
import operator
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from itertools import pairwise
from types import CodeType, ModuleType
from typing import Any

from imaging.errors import AutoexposeError

DELAY_FRAMES = 2  # As `runs.MAIN_DELAY`, which may not be imported here yet
Course = tuple[str, str, int]  # Scenario, scene and seed
Decisions = list[dict[str, Any]]  # One for each frame, as plain data


@dataclass(frozen=True, slots=True)
class Alteration:
    """The text to take the place of the bytes from `start` to `end` of a module's source."""

    module: str
    start: int
    end: int
    text: str


@dataclass(frozen=True, slots=True)
class AlteredRequest:
    """What to run: scenario, scene and seed of each course, its start (us, dB), and a bound on the frames of each."""

    alteration: Alteration | None
    policy: str
    courses: Sequence[tuple[str, str, int]]
    starts: Sequence[Sequence[float]]
    frames: int | None = None


class AlteredModule(MetaPathFinder):
    """Finds one module, with its source altered; to be put before all other finders."""

    def __init__(self, alteration: Alteration) -> None:
        self._alteration = alteration

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification of the altered module; None for all others."""
        found = PathFinder.find_spec(fullname, path) if fullname == self._alteration.module else None
        if found is None or found.origin is None:
            return None
        return spec_from_file_location(fullname, found.origin, loader=_Altered(self._alteration, found.origin))


class _Altered(SourceFileLoader):
    def __init__(self, alteration: Alteration, path: str) -> None:
        super().__init__(alteration.module, path)
        self._alteration = alteration

    def get_code(self, fullname: str) -> CodeType:
        """Of the altered source, never of what is cached."""
        source, change = self.get_data(self.path), self._alteration
        return compile(source[: change.start] + change.text.encode() + source[change.end :], self.path, "exec")


def run_altered(request: Mapping[str, Any]) -> list[Any] | str:
    """The `Decisions` in each course, from a fresh process; a string: what the alteration breaks. `request`: a plain
    `AlteredRequest`.

    Raises AutoexposeError when the process fails.
    """
    command = [sys.executable, "-m", __name__]
    done = subprocess.run(command, input=json.dumps(request), capture_output=True, text=True, check=False)
    if done.returncode == 0:
        decisions: list[Any] | str = json.loads(done.stdout)
        return decisions
    raise AutoexposeError(f"a process ended with {done.returncode}: {done.stderr.strip()[-300:] or 'it was killed'}")


def roll_out(policy: str, course: Course, start: Sequence[float], frames: int | None = None) -> Decisions:
    """The decisions of a policy in closed loop; imports what it needs only when the alteration is in place."""
    import cv2  # noqa: PLC0415

    from evaluation.arena.race import course_of  # noqa: PLC0415
    from evaluation.scenes.scenarios import SCENARIOS  # noqa: PLC0415
    from evaluation.stage.camera import Entrant  # noqa: PLC0415
    from imaging.exposure import ExposureSetting  # noqa: PLC0415

    cv2.setNumThreads(1)
    stage, _ = course_of(*course)
    delayed = Entrant.of(policy, DELAY_FRAMES).enter(ExposureSetting(*start))
    for frame in range(frames or SCENARIOS[course[0]].frames):
        stage.go_to(frame)
        delayed.step(stage.take)
    return [asdict(decision) for decision in delayed.decisions]


def _answer(request: dict[str, Any]) -> list[Any] | str:
    if request["alteration"]:
        sys.meta_path.insert(0, AlteredModule(Alteration(**request["alteration"])))
    try:
        return [
            roll_out(request["policy"], tuple(course), start, request["frames"])
            for course, start in zip(request["courses"], request["starts"], strict=True)
        ]
    except Exception as error:  # what an altered constant breaks is a result, too
        return f"{type(error).__name__}: {error}"


_OPERATIONS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_DEFINED_IN_C = re.compile(
    r"(?:#define\s+(\w+)\s+|\b(\w+)\s*=\s*)\(?([\d.][\deE.*/ +-]*)[fFuUlL]*\)?\s*(?:$|[,;}]|/[/*])", re.M
)
_UPPER_CASE = re.compile(r"_?[A-Z][A-Z0-9_]*")
_FIRST_SENTENCE = re.compile(r".*?(?<!\.)(?<!e\.g)\.(?=\s|$)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Constant:
    """A number that a file gives a name in upper case, in a module or a class."""

    module: str
    name: str  # within its module, such as `BIN`, `Scene.BINS` or, for an argument, `Scene.TAILS.longest`
    value: float
    # The first sentence of the string below it, or below the run of lines that it belongs to; empty: it has none.
    reason: str
    # By what is done to it: `x 2`, `/ 2` and, where the module's `NEUTRAL` has its name, `off`.
    alterations: dict[str, Alteration]


def constants_of(module: str, source: str) -> list[Constant]:
    """All constants of a module that are numbers or made of numbers alone. The module may have a dictionary `NEUTRAL`
    from names of its constants to the value at which each has no effect."""
    tree = ast.parse(source)
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    neutral: dict[str, str] = {}
    for _, name, node in _assigned(tree.body):
        if name == "NEUTRAL" and isinstance(node, ast.Dict):
            keys = [ast.literal_eval(key) for key in node.keys if key]
            neutral = dict(zip(keys, map(ast.unparse, node.values), strict=True))
    found = []
    scopes = [("", tree.body), *((f"{each.name}.", each.body) for each in tree.body if isinstance(each, ast.ClassDef))]
    for scope, body in scopes:
        for reason, name, node in _assigned(body):
            arguments = node.keywords if isinstance(node, ast.Call) else []
            for suffix, part in [("", node), *((f".{each.arg}", each.value) for each in arguments)]:
                value = _number(part)
                if value is not None:
                    assert part.end_lineno is not None and part.end_col_offset is not None
                    place = (
                        starts[part.lineno - 1] + part.col_offset,
                        starts[part.end_lineno - 1] + part.end_col_offset,
                    )
                    full_name = f"{scope}{name}{suffix}"
                    texts = _altered(value, neutral.get(full_name))
                    changes = {what: Alteration(module, *place, text) for what, text in texts.items()}
                    found.append(Constant(module, full_name, value, reason, changes))
    return found


def constants_in_c(source: str) -> set[tuple[str, float]]:
    """Names and values that a C file gives numbers by #define, in an enum or otherwise."""
    found = set()
    for macro, other, text in _DEFINED_IN_C.findall(source):
        with suppress(SyntaxError):  # cut off within an expression
            value = _number(ast.parse(text.strip(), mode="eval").body)
            if value is not None:
                found.add((macro or other, value))
    return found


def _assigned(body: Sequence[ast.stmt]) -> Iterator[tuple[str, str, ast.expr]]:
    """Reason, name and value of what is assigned to names in upper case."""
    for place, statement in enumerate(body):
        match statement:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                pairs = list(zip(names, values, strict=False))
            case ast.Assign(targets=[name], value=value) | ast.AnnAssign(target=name, value=ast.expr() as value):
                pairs = [(name, value)]
            case _:
                continue
        for name, value in pairs:
            if isinstance(name, ast.Name) and _UPPER_CASE.fullmatch(name.id):
                yield _reason(body[place:]), name.id, value


def _reason(following: Sequence[ast.stmt]) -> str:
    for before, statement in pairwise(following):
        match statement:
            case ast.Expr(value=ast.Constant(value=str(text))):
                sentence = _FIRST_SENTENCE.match(text)
                return " ".join((sentence.group() if sentence else text).split())
            case ast.Assign() | ast.AnnAssign() if statement.lineno == (before.end_lineno or 0) + 1:
                continue
        break
    return ""


def _altered(value: float, neutral: str | None) -> dict[str, str]:
    half = value // 2 if isinstance(value, int) else value / 2.0
    texts = {"x 2": repr(2 * value), "/ 2": repr(half)} if value else {}
    if half == 0:
        texts.pop("/ 2", None)  # of a count of 1 nothing would be left
    return texts if neutral is None else {**texts, "off": neutral}


def _number(node: ast.expr) -> float | None:
    """The value of an expression of numbers alone; None for any other."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            positive = _number(operand)
            return None if positive is None else -positive
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
            first, second = _number(left), _number(right)
            return None if first is None or second is None else _OPERATIONS[type(op)](first, second)
    return None


if __name__ == "__main__":
    json.dump(_answer(json.load(sys.stdin)), sys.stdout)
