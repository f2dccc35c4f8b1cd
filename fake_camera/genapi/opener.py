"""Opens features of a described camera: finds register contents with which they exist, unlocked and within limits."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from fake_camera.genapi.description import Node, NodeError
from fake_camera.genapi.dialect import NUMBERS
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.formula import Number
from fake_camera.genapi.solve import Wish, achieve, assign, fill


class Wished(NamedTuple):
    """Limits, increment and value of a number at power-on, where the description leaves them to registers."""

    low: float
    high: float
    step: float
    value: float

    def over(self, unit: float) -> Wished:
        """The same, counted in units of `unit`."""
        return Wished(*(number / unit for number in self))


class _Attempt(NamedTuple):
    """How to set a number: what empty registers are filled with on trial, since formulas may divide by them."""

    filling: int
    shared: bool = False
    """Whether limits may be in registers that are no longer empty, as long as what else is in them stays sound."""
    clipped: bool = False
    """Whether a value is good enough that the limits have clipped."""
    fine: bool = False
    """Whether a number without an increment must take steps as small as wished: its fraction's bits may be counted."""


_FILLINGS = (0, 1, 10, 1_000_000)
"""Counts, a time base (us)."""
_ATTEMPTS = (
    *(_Attempt(filling) for filling in _FILLINGS), _Attempt(0, shared=True),
    *(_Attempt(filling, clipped=True) for filling in _FILLINGS),
)  # fmt: skip
_EXISTS = (("pIsImplemented", True), ("pIsAvailable", True))
_CONDITIONS = (*_EXISTS, ("pIsLocked", False))
_COARSER = (1, 10, 100, 1000, 10_000)
"""Times the increment wished, where the units of a register allow none finer."""
_ALMOST = 1e-6  # of an increment
_LIMITS = ("pMin", "pMax", "pInc")


class Opener:
    """Sets the registers behind features.

    Attributes
    ----------
    evaluator
        What it sets them through.
    failed
        Features that could not be made available.
    """

    def __init__(self, evaluator: Evaluator) -> None:
        self.evaluator = evaluator
        self._selection: tuple[tuple[str, int], ...] = ()
        self._kept: dict[int, list[Wish]] = {}
        self.failed: list[str] = []

    def entry(self, name: str) -> str:
        """The present entry of an enumeration; empty if it has none."""
        if self.evaluator.kind(name) == "Enumeration":
            with contextlib.suppress(NodeError):
                value = self.evaluator.value(name)
                for entry, node in self.evaluator.node(name).entries.items():
                    if node.integer("Value", 0) == value:
                        return entry
        return ""

    @contextlib.contextmanager
    def selecting(self, selector: str, entry: str, now: bool = True) -> Iterator[bool]:
        """Within the block the selector is at this entry, and from `now` on; yields whether it has that entry."""
        if self.evaluator.kind(selector) != "Enumeration" or entry not in self.evaluator.node(selector).entries:
            yield False
            return
        if now:
            self.choice(selector, (entry,))
        with self.at(selector, self.evaluator.node(selector).entries[entry].integer("Value", 0)):
            yield True

    @contextlib.contextmanager
    def at(self, name: str, value: int) -> Iterator[None]:
        """Within the block conditions must hold while the client has set `name` to `value`."""
        if self.evaluator.kind(name) is None:
            yield
            return
        before = self._selection
        self._selection = (*before, (name, value))
        with self.evaluator.selecting(name, value):
            yield
        self._selection = before

    def number(self, name: str, wished: Wished, writable: bool = True) -> None:
        """Open a number, set its limits where they are in registers, and its value within the limits it then has."""
        evaluator = self.evaluator
        if evaluator.kind(name) not in NUMBERS or not self.open(name, writable):
            return
        if self.adjust(name, wished):
            self.open(name, writable)  # its limits may share a register with what it depends on
        elif writable:
            self.failed.append(name)

    def adjust(self, name: str, wished: Wished) -> bool:
        """Set the limits of a number where they are in registers, and its value; whether it has both then."""
        evaluator = self.evaluator
        parts = [name, *(node.text(tag) for node in evaluator.chain(name) for tag in _LIMITS if node.text(tag))]
        empty = fill(evaluator, parts, 0)
        fractions = [(_Attempt(10, fine=True), [register]) for register in empty]
        divisors = [(_Attempt(1), [register]) for register in empty]  # and no switch beside it
        trials: list[tuple[_Attempt, list[str] | None]] = [(_Attempt(0, fine=True), []), *fractions]
        trials += [(_ATTEMPTS[0], []), *divisors, *((attempt, None) for attempt in _ATTEMPTS[1:])]
        for attempt, only in trials:
            for register in empty:
                evaluator.set(register, attempt.filling if only and register in only else 0)
            if only is None:
                filled = fill(evaluator, parts, attempt.filling)
                empty += [register for register in filled if register not in empty]
            with contextlib.suppress(NodeError):
                self._limit(name, wished, attempt, only if only and attempt.fine else ())
                if self._place(name, wished, attempt):
                    return True
        for register in empty:
            evaluator.set(register, 0)
        return False

    def _limit(self, name: str, wished: Wished, attempt: _Attempt, kept: Sequence[str]) -> None:
        """Set the increment and the limits that are in registers; those that are `kept` are left alone."""
        evaluator = self.evaluator
        holder, value = evaluator.bounded(name, wished.value)
        # A falling converter swaps them.
        ends = [evaluator.bounded(name, end)[1] for end in (wished.low, wished.high)]
        step = abs(evaluator.bounded(name, wished.value + wished.step)[1] - value)
        if evaluator.is_whole(holder):
            step = max(round(step), 1)
        done = [*kept]
        ours: set[str] = set()

        def settle(limit: str, number: float) -> None:
            registers = evaluator.fields(limit) if limit not in ("", *done) else {}
            free = [node for node in registers if node in ours or evaluator.value(node) in (0, attempt.filling)]
            if math.isfinite(number) and (free or (registers and attempt.shared)):
                assign(evaluator, limit, number, done)
                ours.update(registers)

        increment = next(filter(None, (node.text("pInc") for node in evaluator.chain(name))), "")
        for coarser in _COARSER:
            settle(increment, step * coarser)
            if not increment or evaluator.value(increment) > 0:
                break
        done += filter(None, [increment])
        if evaluator.is_whole(holder):  # a value that is a multiple of the increment is then on it
            step = evaluator.bound(holder, "Inc") or 1
            ends = [math.ceil(min(ends) / step) * step, max(ends)]
        least, most = (evaluator.node(holder).text(tag) for tag in ("pMin", "pMax"))
        settle(least, min(ends))
        done += filter(None, [least])
        settle(most, max(ends))

    def _place(self, name: str, wished: Wished, attempt: _Attempt) -> bool:
        """Set a number within its limits and on its increment; whether it took it."""
        evaluator = self.evaluator
        holder, _ = evaluator.bounded(name, wished.value)  # a converter would swap limits that are the wrong way round
        low, high = evaluator.limits(holder)
        step = evaluator.bound(name, "Inc")
        if step is not None and step <= 0:
            return False
        value = self.on_increment(name, wished.value)
        if attempt.fine and not step and not self._is_fine(name, value, wished.step):
            return False
        assign(evaluator, name, value)
        near = abs(evaluator.value(name) - value) <= 0.01 * abs(value)
        sized = low < high or math.isinf(wished.high)
        return near and sized and (attempt.clipped or abs(value - wished.value) <= (step or 0))

    def _is_fine(self, name: str, value: Number, step: float) -> bool:
        """Whether a number takes steps as small as `step`."""
        assign(self.evaluator, name, value + step)
        return abs(self.evaluator.value(name) - value - step) <= step / 2

    def on_increment(self, name: str, value: Number) -> Number:
        """The nearest value within the limits of a number that is on its increment, or below."""
        low, high = self.evaluator.limits(name)
        step = self.evaluator.bound(name, "Inc")
        value = min(max(value, low), high)
        return low + math.floor((value - low) / step + _ALMOST) * step if step and math.isfinite(low) else value

    def command(self, name: str) -> None:
        """Open a command, where there is one."""
        if self.evaluator.kind(name) == "Command":
            self.open(name)

    def switch(self, name: str, on: bool) -> None:
        """Open a switch, and turn it."""
        if self.evaluator.kind(name) and self.open(name):
            assign(self.evaluator, name, int(on))

    def choice(self, name: str, entries: Sequence[str]) -> None:
        """Open an enumeration and those of `entries` that it has, and choose the first that can be opened."""
        if self.evaluator.kind(name) != "Enumeration" or not self.open(name):
            return
        there = self.evaluator.node(name).entries
        wanted = [entry for entry in entries if entry in there]
        opened = [entry for entry in wanted if self._meet((there[entry],), _CONDITIONS)]
        if opened:
            assign(self.evaluator, name, there[opened[0]].integer("Value", 0))
        elif wanted:
            self.failed.append(f"{name} {wanted[0]}")

    def open(self, name: str, writable: bool = True) -> bool:
        """Make a node, and those it depends on, implemented, available and not locked; False if it cannot be."""
        evaluator = self.evaluator
        if evaluator.kind(name) is None:
            return False
        try:
            chain, sources = evaluator.chain(name), evaluator.sources(name)
        except NodeError:  # a node is missing in the description
            self.failed.append(name)
            return False
        opened = self._meet(chain, _CONDITIONS if writable else _EXISTS)
        opened &= self._meet([source for source in sources if source not in chain], _EXISTS)
        if not opened:
            self.failed.append(name)
        return opened

    def _meet(self, nodes: Sequence[Node], conditions: Sequence[tuple[str, bool]]) -> bool:
        """Whether the conditions of all nodes could be met."""
        wanted = [(node.text(tag), value) for node in nodes for tag, value in conditions if node.text(tag)]
        met = [self._fulfil(condition, value) for condition, value in wanted]
        return all(met)

    def _fulfil(self, condition: str, wanted: bool) -> bool:
        """Find register contents that make a condition true, and keep it true."""
        evaluator, selection = self.evaluator, self._selection

        def wish() -> bool:
            with contextlib.ExitStack() as selected:
                for name, value in selection:
                    selected.enter_context(evaluator.selecting(name, value))
                return bool(evaluator.value(condition)) == wanted

        if not achieve(evaluator, wish, condition, self._kept):
            return False
        for field in evaluator.fields(condition).values():
            self._kept.setdefault(field.address, []).append(wish)
        return True
