"""Finds what registers must hold for a node to have a wanted value, where no formula can be inverted."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

from fake_camera.genapi.description import NodeError
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.field import Field
from fake_camera.genapi.formula import Number

Wish = Callable[[], bool]
_CLOSE = 1e-6
_COARSE = 0.5  # what a bit may add of the value wished, for it to count as that
_MOST_PAIRS = 2000  # of registers that are tried together
_STEPS = 64  # halvings of a 64-bit register


def assign(evaluator: Evaluator, name: str, value: Number, kept: Sequence[str] = ()) -> None:
    """Make a node evaluate to `value`, or as near to it as its registers allow; a constant node keeps its value.

    First through the node's own pValue and converters; else from the bits of the registers that it depends on, by what
    each bit adds (sums, shifts, scales); else by bisecting one register (any monotonic formula), at last with 1 in the
    empty ones (products, quotients). What else is in these registers stays within its limits, and the nodes `kept` keep
    their values.
    """
    present = [evaluator.value(other) for other in kept]

    def sound(before: dict[str, bytes]) -> bool:
        changed = [node for node, data in before.items() if evaluator.bytes_of(fields[node]) != data]
        return all(map(evaluator.holds, changed)) and [evaluator.value(other) for other in kept] == present

    for way in (_set, _compose, _halve):
        fields = evaluator.fields(name)
        before = {node: evaluator.bytes_of(field) for node, field in fields.items()}
        if fields and way(evaluator, name, value, fields, kept) and sound(before):
            return
        _restore(evaluator, fields, before)
    filled = fill(evaluator, (name,), 1)
    if not filled or not _halve(evaluator, name, value, evaluator.fields(name), kept):
        for node in filled:
            evaluator.set(node, 0)


def fill(evaluator: Evaluator, names: Sequence[str], number: Number) -> list[str]:
    """Fill the empty registers behind some nodes, and those that come into play thereby; returns which."""
    filled: list[str] = []
    while True:
        seen = dict.fromkeys(node for name in names for node in evaluator.fields(name) if node not in filled)
        empty = [node for node in seen if not evaluator.value(node)]
        if not empty:
            return filled
        for node in empty:
            evaluator.set(node, number)
            if number and not evaluator.holds(node):
                evaluator.set(node, 1)
        filled += empty


def achieve(evaluator: Evaluator, wish: Wish, name: str, kept: Mapping[int, Sequence[Wish]]) -> bool:
    """Try values in the registers behind the node `name` until `wish` holds; whether it does.

    Wishes `kept` for the address of a register that changes must stay true. One register is changed at a time (to the
    numbers that the formulas compare with, single bits, zero, all ones), then two, one of them to a small number.
    """
    if _holds(wish):
        return True
    fields = evaluator.fields(name)
    constants = {int(text, 0) for text in re.findall(r"\b(?:0[xX][0-9a-fA-F]+|\d+)\b", _formulas(evaluator, name))}
    trials = [(node, value) for node in fields for value in _trials(evaluator, fields[node], constants)]
    small = [(node, value) for node, value in trials if value in (0, 1, 2, 3)]
    pairs = ((one, other) for one, other in itertools.product(small, trials) if one[0] != other[0])
    changes: Iterator[tuple[tuple[str, int], ...]] = itertools.chain(
        ((trial,) for trial in trials), itertools.islice(pairs, _MOST_PAIRS)
    )
    for change in changes:
        before = {node: evaluator.bytes_of(fields[node]) for node, _ in change}
        for node, value in change:
            evaluator.set(node, value)
        touched = [was for node, _ in change for was in kept.get(fields[node].address, ())]
        if _holds(wish) and all(map(_holds, touched)):
            return True
        _restore(evaluator, fields, before)
    return False


def _holds(wish: Wish) -> bool:
    try:
        return wish()
    except NodeError:
        return False


def _restore(evaluator: Evaluator, fields: dict[str, Field], before: dict[str, bytes]) -> None:
    for node, data in before.items():
        evaluator.write(fields[node], data)


def _trials(evaluator: Evaluator, field: Field, constants: set[int]) -> list[int]:
    """Values worth trying in one register, among them its present one with bits added and taken; all ones at last."""
    present = 0 if field.floating else int(field.decode(evaluator.bytes_of(field)))
    everything = (1 << field.bits) - 1
    bits = [1 << bit for bit in range(min(field.bits, 64))]
    some = sorted(constants - {everything})
    changed = [*(present | value for value in (*some, *bits)), *(present & ~bit for bit in bits)]
    return list(dict.fromkeys([1, 0, *some, *changed, everything]))


def _formulas(evaluator: Evaluator, name: str) -> str:
    """The formulas that a node depends on, joined."""
    seen: set[str] = set()
    texts: list[str] = []

    def collect(name: str) -> None:
        if name in seen or evaluator.kind(name) is None:
            return
        seen.add(name)
        node = evaluator.node(name)
        texts.append(node.text("Formula"))
        for tag in ("pVariable", "pValue"):
            for part in node.parts.get(tag, []):
                collect((part.text or "").strip())

    collect(name)
    return " ".join(texts)


def _set(evaluator: Evaluator, name: str, value: Number, fields: dict[str, Field], kept: Sequence[str]) -> bool:
    """Set it as a client does; whether there is a way to a register."""
    try:
        evaluator.set(name, value)
    except (NodeError, ArithmeticError, ValueError):
        return False
    return True


def _compose(evaluator: Evaluator, name: str, value: Number, fields: dict[str, Field], kept: Sequence[str]) -> bool:
    """Choose bits, those that add most first, until their sum reaches `value`; whether it does."""
    try:
        raw = {node: _without_free_bits(evaluator, node, field, kept) for node, field in fields.items()}
        base = evaluator.value(name)
        parts = [
            part for node, field in fields.items() for part in _contributions(evaluator, name, node, field, raw[node])
        ]
        rest = value - base
        for gain, node, bit in sorted(parts, reverse=True):
            if 0 < gain <= rest * (1 + _CLOSE):
                rest -= gain
                raw[node] |= bit
        for node, number in raw.items():
            evaluator.set(node, number)
        smallest = min((gain for gain, _, _ in parts if gain > 0), default=0.0)
        return abs(evaluator.value(name) - value) <= max(min(smallest, _COARSE * abs(value)), _CLOSE * abs(value))
    except NodeError:
        return False


def _without_free_bits(evaluator: Evaluator, node: str, field: Field, kept: Sequence[str]) -> int:
    """Clear the bits of a register on which no node of `kept` depends; what is left in it."""
    if not kept or field.floating:
        evaluator.set(node, 0)
        return 0
    raw = int(evaluator.value(node))
    present = [evaluator.value(other) for other in kept]
    for bit in (1 << number for number in range(field.bits - field.signed)):
        evaluator.set(node, raw ^ bit)
        if [evaluator.value(other) for other in kept] == present:
            raw &= ~bit
        evaluator.set(node, raw)
    return raw


def _contributions(
    evaluator: Evaluator, name: str, node: str, field: Field, raw: int
) -> Iterator[tuple[Number, str, int]]:
    """What each empty bit of a register, alone, adds to the value of `name`."""
    if field.floating:
        return
    base = evaluator.value(name)
    for bit in (1 << number for number in range(field.bits - field.signed)):
        if not raw & bit:
            evaluator.set(node, raw | bit)
            yield evaluator.value(name) - base, node, bit
    evaluator.set(node, raw)


def _halve(evaluator: Evaluator, name: str, value: Number, fields: dict[str, Field], kept: Sequence[str]) -> bool:
    """Bisect the registers one by one for the number that comes nearest to `value`; whether one came near."""
    present = [evaluator.value(other) for other in kept]
    for node, field in reversed(fields.items()):  # divisors come after what many nodes share, such as a time base
        before = evaluator.bytes_of(field)
        found = _search(evaluator, name, value, node, field) and evaluator.holds(node)
        if found and [evaluator.value(other) for other in kept] == present:
            return True
        evaluator.write(field, before)
    return False


def _search(evaluator: Evaluator, name: str, value: Number, node: str, field: Field) -> bool:
    def at(number: Number) -> float:
        evaluator.set(node, number)
        try:
            return float(evaluator.value(name)) - value
        except NodeError:
            return math.nan

    low, high = (1e-6, 1e12) if field.floating else (1, (1 << field.bits - field.signed) - 1)
    below, above = at(low), at(high)
    if math.isnan(below) or math.isnan(above) or below * above > 0:
        return False
    for _ in range(_STEPS):
        middle = math.sqrt(low * high) if field.floating else (int(low) + int(high)) // 2
        error = at(middle)
        low, high = (middle, high) if (error < 0) == (below < 0) else (low, middle)
    best = min((low, high), key=lambda number: abs(at(number)))
    return abs(at(best)) <= 0.05 * abs(value) + _CLOSE
