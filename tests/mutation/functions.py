"""Which function a line of source belongs to, and which functions use a name of the module."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

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
    """The functions that use, by name, what the module-level statement at a line defines.

    Names defined from it count as well; a name imported elsewhere is followed there. Of a class all methods do.

    Parameters
    ----------
    sources
        All files: text by path.
    path, line
        The statement.
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
