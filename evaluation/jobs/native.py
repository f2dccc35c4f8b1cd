"""Which files of the C extension Python files reach by the functions that they call."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from imaging.errors import ConfigurationError

ROOT = Path(__file__).resolve().parents[2]
NATIVE = "autoexpose_daemon/control/native"
_METHOD = re.compile(r"\{\s*\"(\w+)\"\s*,")
_INCLUDE = re.compile(r"^\s*#\s*include\s+\"([^\"]+)\"", re.MULTILINE)


def c_files(python: Sequence[Path], root: Path = ROOT) -> list[Path]:
    """The files of the C extension with the functions that these Python files call, and all that those need.

    Raises ConfigurationError when there are none.
    """
    sources = sorted((root / NATIVE).rglob("*.c"))
    if not sources:
        raise ConfigurationError(f"{root / NATIVE}: no C files to count: run this from a checkout of the sources")
    names = {node.attr for path in python for node in ast.walk(tree(path)) if isinstance(node, ast.Attribute)}
    ahead = [path for path in sources if names.intersection(_METHOD.findall(path.read_text(encoding="utf-8")))]
    reached: set[Path] = set()
    while ahead:
        path = ahead.pop()
        if path in reached or not path.exists():
            continue
        reached.add(path)
        included = _INCLUDE.findall(path.read_text(encoding="utf-8"))
        ahead += [folder / name for folder in (path.parent, root / NATIVE) for name in included]
        ahead.append(path.with_suffix(".c"))
    return sorted(reached)


@cache
def tree(path: Path) -> ast.Module:
    """What is in a Python file."""
    return ast.parse(path.read_text(encoding="utf-8"))
