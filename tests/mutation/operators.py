"""What can be changed in a source file, one thing at a time: numbers, signs, comparisons, booleans, extremes, returns.

Left alone: words (docstrings, messages of errors and the log, f-strings), annotations, decorators, assertions.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import dataclass
from typing import TypeVar

SMALL = 10
"""Whole numbers below this count something and are changed by one; greater ones are sizes, and are doubled."""

OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift,
}  # fmt: skip
OPPOSITES: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
_PAIRS = (("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("floor", "ceil"), ("any", "all"))
SWAPPED = {**dict(_PAIRS), **{second: first for first, second in _PAIRS}}
HARMLESS_KEYWORDS = ("strict", "copy", "highlight", "soft_wrap")
"""``zip(strict=)`` and ``astype(copy=)`` say what is known anyway; the others are for a terminal to look nice."""

LOGGERS = ("_log", "log")


Site = tuple[ast.expr | ast.stmt, str]
"""A node, and the source to put in its place."""

Node = TypeVar("Node", bound=ast.AST)


@dataclass(frozen=True, slots=True)
class Change:
    """One thing changed in a source file."""

    line: int  # counted from 1
    start: int  # of the bytes replaced
    stop: int
    before: str  # what is replaced, and by what, on one line
    after: str

    def apply(self, source: str) -> str:
        """The file with this change."""
        whole = source.encode()
        return (whole[: self.start] + self.after.encode() + whole[self.stop :]).decode()


def changes(source: str) -> list[Change]:
    """All changes of a file, in its order."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for node, after in _walk(ast.parse(source)):
        assert node.end_lineno is not None and node.end_col_offset is not None
        start, stop = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
        found.append(Change(node.lineno, start, stop, ast.unparse(node), after))
    return found


def _walk(node: ast.AST) -> Iterator[Site]:
    for operator in (_number, _sign, _comparison, _boolean, _condition, _extreme, _returned):
        yield from operator(node)
    for child in _worth_changing(node):
        yield from _walk(child)


def _worth_changing(node: ast.AST) -> Iterable[ast.AST]:
    """The parts of a node that a computer, not a person, goes by."""
    if _is_for_people(node):
        return ()
    match node:
        case ast.FunctionDef():
            return (*node.args.defaults, *(value for value in node.args.kw_defaults if value), *node.body)
        case ast.ClassDef():
            return node.body
        case ast.AnnAssign():
            return (node.value,) if node.value else ()
        case ast.Call():
            keywords = (keyword.value for keyword in node.keywords if keyword.arg not in HARMLESS_KEYWORDS)
            return (node.func, *node.args, *keywords)
        case _:
            return ast.iter_child_nodes(node)


def _is_for_people(node: ast.AST) -> bool:
    match node:
        case ast.JoinedStr() | ast.Raise() | ast.Assert() | ast.Expr(value=ast.Constant()):
            return True
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id=name)))):
            return name in LOGGERS
        case _:
            return False


def _number(node: ast.AST) -> Iterator[Site]:
    match node:
        case ast.Constant(value=bool(value)):
            yield node, str(not value)
        case ast.Constant(value=int(value)):
            yield node, str(value + 1 if value < SMALL else 2 * value)
        case ast.Constant(value=float(value)):
            for other in (2 * value, value / 2) if value else (1.0,):
                yield node, repr(other)


def _sign(node: ast.AST) -> Iterator[Site]:
    match node:
        case ast.UnaryOp(op=ast.USub()):
            yield node, _bracketed(node.operand)
        case ast.BinOp() if type(node.op) in OPERATORS and not (_is_text(node.left) or _is_text(node.right)):
            yield node, _bracketed(_with(node, op=OPERATORS[type(node.op)]()))
        case ast.AugAssign() if type(node.op) in OPERATORS and not _is_text(node.value):
            yield node, ast.unparse(_with(node, op=OPERATORS[type(node.op)]()))


def _comparison(node: ast.AST) -> Iterator[Site]:
    if isinstance(node, ast.Compare):
        for place, op in enumerate(node.ops):
            flipped = [*node.ops[:place], OPPOSITES[type(op)](), *node.ops[place + 1 :]]
            yield node, _bracketed(_with(node, ops=flipped))


def _boolean(node: ast.AST) -> Iterator[Site]:
    match node:
        case ast.BoolOp():
            yield node, _bracketed(_with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And()))
        case ast.UnaryOp(op=ast.Not()):
            yield node, _bracketed(node.operand)


def _condition(node: ast.AST) -> Iterator[Site]:
    """Conditions that are but a value; comparisons are flipped where they stand."""
    match node:
        case ast.If() | ast.While() | ast.IfExp():
            tests = [node.test]
        case ast.comprehension():
            tests = node.ifs
        case _:
            tests = []
    for test in tests:
        if isinstance(test, ast.Name | ast.Attribute | ast.Call | ast.Subscript):
            yield test, f"(not {ast.unparse(test)})"


def _extreme(node: ast.AST) -> Iterator[Site]:
    match node:
        case ast.Call(func=ast.Name(id=name)) if name in SWAPPED:
            yield node.func, SWAPPED[name]
        case ast.Call(func=ast.Attribute(attr=name)) if name in SWAPPED:
            yield node.func, ast.unparse(_with(node.func, attr=SWAPPED[name]))


def _returned(node: ast.AST) -> Iterator[Site]:
    match node:
        case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
            yield node, "return None"


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _with(node: Node, **fields: object) -> Node:
    changed = copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _bracketed(node: ast.AST) -> str:
    """Source of an expression that may stand anywhere."""
    text = ast.unparse(node)
    return text if isinstance(node, ast.Name | ast.Constant | ast.Call) else f"({text})"
