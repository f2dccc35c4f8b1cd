"""How much a policy's decision is made of: numbers, branches and remembered fields, to compare before and after."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import PLACES
from autoexpose_daemon.control.snapshot import Plain
from evaluation.arena.race import course_of
from evaluation.jobs.native import ROOT, c_files, tree
from evaluation.prose import text_beside
from evaluation.stage.camera import Entrant
from evaluation.stage.oracle import Oracle, best_start
from imaging.geometry import SIDES

LOOP = "autoexpose_daemon.control.loop"
SCOPE = ("autoexpose_daemon.control", "imaging.exposure", "imaging.response")
# Frames before the snapshot: enough to fill what a frame leaves behind, and what its decision's outcome does.
FRAMES = 12

_C = re.compile(
    r"""//[^\n]* | /\*.*?\*/ | L?"(?:\\.|[^"\\\n])*" | '(?:\\.|[^'\\\n])*'
    | ^[ \t]*\#[ \t]*(?!define\b)\w+(?:\\\n|[^\n])*
    | (?P<number>\.?\d(?:[eEpP][+-]|[\w.])*) | (?P<word>[A-Za-z_]\w*) | (?P<conditional>\?)""",
    re.VERBOSE | re.MULTILINE | re.DOTALL,
)
_SMALL = re.compile(r"(?:0*[012](?:\.0*)?|\.0+|0[xX]0*[012])[uUlLfF]*")


@dataclass(frozen=True, slots=True)
class Count:
    """Numeric literals other than 0, 1, 2 and -1, and branches."""

    numbers: int
    branches: int


def count_python(source: str) -> Count:
    """What a Python file is made of."""
    nodes = list(ast.walk(ast.parse(source)))
    numbers = [node.value for node in nodes if isinstance(node, ast.Constant) and type(node.value) in (int, float)]
    cases = [node for node in nodes if isinstance(node, ast.match_case) and ast.unparse(node.pattern) != "_"]
    filters = [each for node in nodes if isinstance(node, ast.comprehension) for each in node.ifs]
    conditions = [node for node in nodes if isinstance(node, ast.If | ast.IfExp | ast.While)]
    return Count(sum(value not in (0, 1, 2) for value in numbers), len(cases) + len(filters) + len(conditions))


def count_c(source: str) -> Count:
    """What a C file is made of."""
    tokens = [(token.lastgroup, token.group()) for token in _C.finditer(source)]
    numbers = sum(kind == "number" and not _SMALL.fullmatch(text) for kind, text in tokens)
    branches = sum(kind == "conditional" or text in ("if", "while", "case") for kind, text in tokens)
    return Count(numbers, branches)


def python_files(policy_id: str, root: Path = ROOT) -> dict[str, Path]:
    """The modules that a policy's decision reaches, with their files."""
    reached: dict[str, Path] = {}
    ahead = [LOOP, f"autoexpose_daemon.control.policies.{PLACES[policy_id].rpartition('.')[0]}"]
    while ahead:
        module = ahead.pop()
        path = _file(module, root)
        if module in reached or path is None or not f"{module}.".startswith(tuple(f"{each}." for each in SCOPE)):
            continue
        reached[module] = path
        ahead += [_home(origin, name, root) for origin, name in _imported(path)]
    return dict(sorted(reached.items()))


def snapshot_fields(state: Plain) -> set[str]:
    """Names of the values in a snapshot; cameras and items of lists are told apart by nothing."""
    match state:
        case dict() if state:
            of_cameras = set(state) <= set(SIDES)
            members = [("" if of_cameras else f".{name}", value) for name, value in state.items()]
        case list() if state:
            members = [("", value) for value in state]
        case _:
            return {""}
    return {name + rest for name, value in members for rest in snapshot_fields(value)}


def snapshot_of(policy_id: str, frames: int = FRAMES) -> dict[str, Plain]:
    """The state of a loop after some frames of a tuning course."""
    stage, _ = course_of("pan", "room", 0)
    delayed = Entrant.of(policy_id).enter(best_start(Oracle(stage)))
    for frame in range(frames):
        stage.go_to(frame)
        delayed.step(stage.take)
    loop: ControlLoop = delayed.loop
    return loop.state()


def count_policy(policy_id: str) -> dict[str, Any]:
    """All counts of a policy's decision: by file, in total, and the fields of its snapshot."""
    python = list(python_files(policy_id).values())
    counts = {path: count_python(path.read_text(encoding="utf-8")) for path in python}
    counts |= {path: count_c(path.read_text(encoding="utf-8")) for path in c_files(python)}
    files = [
        {"file": str(path.relative_to(ROOT)), "numbers": count.numbers, "branches": count.branches}
        for path, count in counts.items()
    ]
    return {
        "policy": policy_id,
        "rule": text_beside(__file__),
        "numbers": sum(count.numbers for count in counts.values()),
        "branches": sum(count.branches for count in counts.values()),
        "snapshot_fields": len(snapshot_fields(snapshot_of(policy_id))),
        "files": files,
    }


def print_count(counts: dict[str, Any], console: Console) -> None:
    """As a table by file, with totals."""
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, show_footer=True)
    table.add_column(f"what {counts['policy']} decides by", f"{len(counts['files'])} files")
    table.add_column("numbers", str(counts["numbers"]), justify="right")
    table.add_column("branches", str(counts["branches"]), justify="right")
    for each in counts["files"]:
        table.add_row(each["file"], str(each["numbers"]), str(each["branches"]))
    console.print(table)
    console.print(
        f"fields of a snapshot: {counts['snapshot_fields']}\n\n{text_beside(__file__)}", highlight=False, soft_wrap=True
    )


def _file(module: str, root: Path) -> Path | None:
    path = root.joinpath(*module.split("."))
    return next((each for each in (path.with_suffix(".py"), path / "__init__.py") if each.exists()), None)


def _home(module: str, name: str, root: Path) -> str:
    """The module that an imported name comes from: the package that hands it on is passed through."""
    if name and _file(f"{module}.{name}", root):
        return f"{module}.{name}"
    path = _file(module, root)
    if path is not None and path.name == "__init__.py":
        for origin, handed_on in _imported(path):
            if handed_on == name:
                return _home(origin, name, root)
    return module


def _imported(path: Path) -> Iterator[tuple[str, str]]:
    """Modules and the names imported from them."""
    ahead: list[ast.AST] = [tree(path)]
    while ahead:
        node = ahead.pop()
        match node:
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                continue
            case ast.Import(names=aliases):
                yield from ((each.name, "") for each in aliases)
            case ast.ImportFrom(module=str(module), names=aliases):
                yield from ((module, each.name) for each in aliases)
        ahead += ast.iter_child_nodes(node)
