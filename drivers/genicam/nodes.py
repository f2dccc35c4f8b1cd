"""A camera's GenICam nodes: the interface to them, numbers in our units, and having them hold values."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import sub
from typing import Literal, Protocol

from drivers.setup import FeatureValue
from imaging.errors import NodeError
from imaging.gain_scale import GainScale

Kind = Literal["float", "integer", "boolean", "enumeration", "string", "command"]


class NodeMap(Protocol):
    """The nodes of one camera, by name.

    Every method that touches the camera raises `NodeError` when the camera or the node's bounds refuse for good,
    `CameraBusyError` when the camera refuses for the moment, and `CameraLostError` when it does not answer.
    """

    @property
    def serial(self) -> str:
        """Serial number of the camera, for messages."""

    def features(self) -> tuple[str, ...]:
        """All features, in the order of the camera's description; categories are not features."""

    def streamable(self) -> frozenset[str]:
        """The features that the description marks as worth storing; empty if it marks none."""

    def kind(self, name: str) -> Kind | None:
        """What kind of feature it is; None if the camera has none of that name, or it holds no value of these kinds."""

    def writable(self, name: str) -> bool:
        """Whether the feature is available, and neither read-only nor locked at present."""

    def selected(self, name: str) -> tuple[str, ...]:
        """The features whose values depend on this one; empty if it is not a selector."""

    def exists(self, name: str) -> bool:
        """Whether the camera has this feature, available or not."""

    def available(self, name: str) -> bool:
        """Whether the camera has this feature and currently offers it; a category is not a feature."""

    def is_float(self, name: str) -> bool:
        """Whether the feature holds a floating-point number."""

    def is_integer(self, name: str) -> bool:
        """Whether the feature holds an integer, not an enumeration or boolean."""

    def unit(self, name: str) -> str | None:
        """The unit that a number declares, None when it declares none."""

    def entries(self, name: str) -> tuple[str, ...]:
        """The entries that an enumeration currently offers; empty if the camera has no such enumeration."""

    def float_bounds(self, name: str) -> tuple[float, float]:
        """Least and greatest value that the feature takes at present."""

    def float_increment(self, name: str) -> float:
        """The declared increment; 0.0 when any value is taken."""

    def integer_bounds(self, name: str) -> tuple[int, int]:
        """Least and greatest value that the feature takes at present."""

    def integer_increment(self, name: str) -> int:
        """The declared increment; 1 when none is declared."""

    def read_float(self, name: str) -> float:
        """Value of a floating-point feature."""

    def write_float(self, name: str, value: float) -> None:
        """Write a floating-point feature."""

    def read_integer(self, name: str) -> int:
        """Value of an integer feature."""

    def write_integer(self, name: str, value: int) -> None:
        """Write an integer feature."""

    def read_boolean(self, name: str) -> bool:
        """Value of a boolean feature."""

    def write_boolean(self, name: str, value: bool) -> None:
        """Write a boolean feature."""

    def read_entry(self, name: str) -> str:
        """The current entry of an enumeration; empty if it holds none that the description has."""

    def write_entry(self, name: str, entry: str) -> None:
        """Choose an entry of an enumeration."""

    def read_string(self, name: str) -> str:
        """Value of a text feature."""

    def write_string(self, name: str, value: str) -> None:
        """Write a text feature."""

    def execute(self, name: str) -> None:
        """Execute a command feature."""


_MICROSECONDS = {"": 1.0, "us": 1.0, "µs": 1.0, "μs": 1.0, "usec": 1.0, "s": 1e6, "ms": 1e3, "ns": 1e-3}
"""No unit means microseconds, as the SFNC prescribes."""
DECIBELS = {"db": 1.0}
"""The only unit of gain with a defined meaning."""

EXACT = 1 << 53
"""Floating-point numbers represent all integers below this one exactly."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A writable number node, floating-point or `integer`, of which one unit is `scale` of ours (us or dB).

    A `gain_scale` says instead what each of its numbers is in dB. `step` (ours) is an increment that the node itself
    does not declare.
    """

    node: str
    scale: float = 1.0
    integer: bool = False
    gain_scale: GainScale | None = None
    step: float = 0.0

    def ours(self, own: float) -> float:
        """A number of the node in our unit."""
        return own * self.scale if self.gain_scale is None else self.gain_scale.gain_db(own)

    def bounds(self, nodes: NodeMap) -> tuple[float, float]:
        """Least and greatest value that the node takes at present."""
        low, high = nodes.integer_bounds(self.node) if self.integer else nodes.float_bounds(self.node)
        if math.isnan(low) or math.isnan(high):
            raise NodeError(
                f"camera {nodes.serial}: the bounds of node {self.node} are not numbers: {low:g} to {high:g}"
            )
        if self.gain_scale is not None:
            low, high = self.gain_scale.bounds(low, high)
        return self.ours(low), self.ours(high)

    def increment(self, nodes: NodeMap) -> float:
        """The declared increment, at least 1 for an integer; 0.0 when any value is taken; the largest, if they vary."""
        if self.gain_scale is not None:
            return max(map(sub, (gains_db := self.uneven_steps(nodes))[1:], gains_db), default=0.0)
        if self.integer:
            return max(nodes.integer_increment(self.node), 1) * self.scale
        increment = nodes.float_increment(self.node) * self.scale
        return increment if increment and math.isfinite(increment) else self.step

    def uneven_steps(self, nodes: NodeMap) -> tuple[float, ...]:
        """The only gains (dB) that the node takes, if a `gain_scale` makes their steps uneven; empty otherwise."""
        if self.gain_scale is None:
            return ()
        own = replace(self, gain_scale=None)
        step = own.increment(nodes)
        return self.gain_scale.gains_of_steps(*self.gain_scale.bounds(*own.bounds(nodes)), step) if step else ()

    def read(self, nodes: NodeMap) -> float:
        """The value that the node holds."""
        value = nodes.read_integer(self.node) if self.integer else nodes.read_float(self.node)
        if not math.isfinite(value):
            raise NodeError(f"camera {nodes.serial}: node {self.node} reads {value:g}, which is not a number")
        return self.ours(value)

    def write(self, nodes: NodeMap, value: float) -> None:
        """Write the node; an integer node takes the nearest multiple of its increment."""
        if not self.integer:
            nodes.write_float(self.node, self._own(nodes, value))
            return
        low, increment = nodes.integer_bounds(self.node)[0], max(nodes.integer_increment(self.node), 1)
        origin = low if abs(low) < EXACT else 0  # no minimum is declared: steps count from 0
        nodes.write_integer(self.node, origin + round((self._own(nodes, value) - origin) / increment) * increment)

    def _own(self, nodes: NodeMap, value: float) -> float:
        """A value in the node's own unit; one at a limit must not exceed it by rounding."""
        if self.gain_scale is not None:
            return self.gain_scale.setting(value)
        if self.scale == 1.0 or self.integer:
            return value / self.scale
        own = value / self.scale
        limits = (limit for limit in nodes.float_bounds(self.node) if math.isclose(own, limit))
        return next(limits, own)


def us_per_unit(unit: str | None) -> float | None:
    """Microseconds in the unit that a time node declares; None for one that is not known."""
    return _MICROSECONDS.get((unit or "").strip().lower())


def is_number(nodes: NodeMap, name: str) -> bool:
    """Whether the camera has this feature and it holds a number."""
    return nodes.is_float(name) or nodes.is_integer(name)


def find_quantity(nodes: NodeMap, names: Sequence[str]) -> Quantity | None:
    """The first of `names` that is a number, in its own unit; None if none is."""
    return next((Quantity(name, integer=nodes.is_integer(name)) for name in names if is_number(nodes, name)), None)


SWITCHED = {False: ("Off", "No", "False"), True: ("On", "Yes", "True")}
"""Entries of an enumeration that is a switch."""
_SELECTORS = ("GainSelector", "TriggerSelector", "LineSelector", "ChunkSelector")


def read_feature(nodes: NodeMap, name: str) -> FeatureValue:
    """The value of a feature, whatever its kind; NodeError if it cannot be read."""
    match nodes.kind(name):
        case "float":
            return nodes.read_float(name)
        case "integer":
            return nodes.read_integer(name)
        case "boolean":
            return nodes.read_boolean(name)
        case "enumeration" if entry := nodes.read_entry(name):
            return entry
        case "string":
            return nodes.read_string(name)
    raise NodeError(f"camera {nodes.serial}: {name} holds no value")


def write_feature(nodes: NodeMap, name: str, value: FeatureValue) -> None:
    """Write a value of the feature's kind."""
    match nodes.kind(name):
        case "float":
            nodes.write_float(name, float(value))
        case "integer":
            nodes.write_integer(name, int(value))
        case "boolean":
            nodes.write_boolean(name, bool(value))
        case "enumeration":
            nodes.write_entry(name, str(value))
        case "string":
            nodes.write_string(name, str(value))
        case "command":
            nodes.execute(name)


def hold(nodes: NodeMap, name: str, value: FeatureValue) -> None:
    """Have a feature hold a value of its kind."""
    present: FeatureValue | None = None
    with suppress(NodeError):  # it cannot be read, or holds no entry that the description has
        present = read_feature(nodes, name)
    if present == value:
        return
    if not nodes.writable(name):
        raise NodeError(
            f"camera {nodes.serial}: its {name} is {present} and cannot be {value}, as it is read-only or locked"
        )
    write_feature(nodes, name, value)


def switch(nodes: NodeMap, name: str, on: bool) -> None:
    """Have a switch on or off, whether it is an enumeration, a boolean or an integer."""
    match nodes.kind(name) if nodes.available(name) else None:
        case "boolean":
            hold(nodes, name, on)
        case "integer":
            hold(nodes, name, int(on))
        case "enumeration":
            entries = nodes.entries(name)
            entry = next((entry for entry in SWITCHED[on] if entry in entries), None)
            if entry is None:
                others = ", ".join(entries) or "nothing"
                raise NodeError(f"camera {nodes.serial}: its {name} has no {SWITCHED[on][0]}, only {others}")
            hold(nodes, name, entry)
        case _:
            raise NodeError(f"camera {nodes.serial}: it has no {name} that can be switched at present")


def unlock(nodes: NodeMap) -> None:
    """Undo the lock on all that decides how frames are sent, which a client that was killed leaves on."""
    if nodes.is_integer("TLParamsLocked"):
        with suppress(NodeError):
            hold(nodes, "TLParamsLocked", 0)


def offered(nodes: NodeMap, name: str) -> tuple[str, ...]:
    """The entries that an enumeration can be had at: of a read-only or locked one, that at which it stands."""
    entries = nodes.entries(name)
    if not entries or nodes.writable(name):
        return entries
    present = nodes.read_entry(name)
    return tuple(entry for entry in entries if entry == present)


def fixed_selectors(nodes: NodeMap) -> Iterator[str]:
    """What a read-only selector leaves out, in words."""
    for name in _SELECTORS:
        entries, had = nodes.entries(name), offered(nodes, name)
        others = [entry for entry in entries if entry not in had]
        if others:
            stays_at = ", ".join(had) or "no entry"
            yield f"its {name} is read-only and stays at {stays_at}: left alone are {', '.join(others)}"
