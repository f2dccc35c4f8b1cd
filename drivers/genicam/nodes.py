"""A camera's GenICam nodes: the interface to them, numbers in our units, and having them hold values."""

from __future__ import annotations

import math
from collections.abc import Iterator
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

    def unit(self, name: str) -> str | None:
        """The unit that a number declares, None when it declares none."""

    def entries(self, name: str) -> tuple[str, ...]:
        """The entries that an enumeration currently offers; empty if the camera has no such enumeration."""

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and greatest value that a number takes at present; of an integer, integers."""

    def increment(self, name: str) -> float:
        """The declared increment of a number; 0 when any value is taken."""

    def read(self, name: str) -> FeatureValue:
        """Value of a feature, of its kind; of an enumeration the entry, empty if the description has none for it."""

    def write(self, name: str, value: FeatureValue) -> None:
        """Write a value of the feature's kind."""

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
    """A writable number node, of which one unit is `scale` of ours (us or dB).

    A `gain_scale` says instead what each of its numbers is in dB. `step` (ours) is an increment that the node itself
    does not declare. `offset` (ours) is taken off whatever the node holds: of a gain, what makes up for missing light.
    """

    node: str
    scale: float = 1.0
    gain_scale: GainScale | None = None
    step: float = 0.0
    offset: float = 0.0

    def ours(self, own: float) -> float:
        """A number of the node in our unit."""
        return (own * self.scale if self.gain_scale is None else self.gain_scale.gain_db(own)) - self.offset

    def bounds(self, nodes: NodeMap) -> tuple[float, float]:
        """Least and greatest value that the node takes at present. Raises NodeError when they are no range."""
        low, high = nodes.bounds(self.node)
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
        increment = nodes.increment(self.node) * self.scale
        if is_number(nodes, self.node, "integer"):
            return max(increment, self.scale)
        return increment if increment and math.isfinite(increment) else self.step

    def uneven_steps(self, nodes: NodeMap) -> tuple[float, ...]:
        """The only gains (dB) that the node takes, if a `gain_scale` makes their steps uneven; empty otherwise."""
        if self.gain_scale is None:
            return ()
        own = replace(self, gain_scale=None, offset=0.0)
        step = own.increment(nodes)
        if not step:
            return ()
        gains_db = self.gain_scale.gains_of_steps(*self.gain_scale.bounds(*own.bounds(nodes)), step)
        return tuple(gain_db - self.offset for gain_db in gains_db)

    def read(self, nodes: NodeMap) -> float:
        """The value that the node holds."""
        value = float(nodes.read(self.node))
        if not math.isfinite(value):
            raise NodeError(f"camera {nodes.serial}: node {self.node} reads {value:g}, which is not a number")
        return self.ours(value)

    def write(self, nodes: NodeMap, value: float) -> None:
        """Write the node; an integer node takes the nearest multiple of its increment."""
        own = self._own(nodes, value)
        if nodes.kind(self.node) == "integer":
            low, increment = nodes.bounds(self.node)[0], max(nodes.increment(self.node), 1)
            origin = low if abs(low) < EXACT else 0  # no minimum is declared: steps count from 0
            own = origin + round((own - origin) / increment) * increment
        nodes.write(self.node, own)

    def _own(self, nodes: NodeMap, value: float) -> float:
        """A value in the node's own unit; one at a limit must not exceed it by rounding."""
        value += self.offset
        if self.gain_scale is not None:
            return self.gain_scale.setting(value)
        own = value / self.scale
        if (self.scale == 1.0 and not self.offset) or nodes.kind(self.node) == "integer":
            return own
        return next((limit for limit in nodes.bounds(self.node) if math.isclose(own, limit, abs_tol=1e-9)), own)


def us_per_unit(unit: str | None) -> float | None:
    """Microseconds in the unit that a time node declares; None for one that is not known."""
    return _MICROSECONDS.get((unit or "").strip().lower())


def is_number(nodes: NodeMap, name: str, kind: Kind | None = None) -> bool:
    """Whether the camera offers this feature at present and it holds a number, of that kind if one is given."""
    return nodes.kind(name) in (("float", "integer") if kind is None else (kind,)) and nodes.available(name)


SWITCHED = {False: ("Off", "No", "False"), True: ("On", "Yes", "True")}
"""Entries of an enumeration that is a switch."""
_SELECTORS = ("GainSelector", "TriggerSelector", "LineSelector", "ChunkSelector")


def read_feature(nodes: NodeMap, name: str) -> FeatureValue:
    """The value of a feature; NodeError if it cannot be read, or is an enumeration that holds none of its entries."""
    value = nodes.read(name)
    if value == "" and nodes.kind(name) == "enumeration":
        raise NodeError(f"camera {nodes.serial}: {name} holds no value")
    return value


def hold(nodes: NodeMap, name: str, value: FeatureValue) -> None:
    """Have a feature hold a value of its kind. Raises NodeError when it holds something else and cannot be set."""
    present: FeatureValue | None = None
    with suppress(NodeError):  # it cannot be read, or holds no entry that the description has
        present = read_feature(nodes, name)
    if present == value:
        return
    if not nodes.writable(name):
        raise NodeError(
            f"camera {nodes.serial}: its {name} is {present} and cannot be {value}, as it is read-only or locked"
        )
    nodes.write(name, value)


def switch(nodes: NodeMap, name: str, on: bool) -> None:
    """Have a switch on or off, whether it is an enumeration, a boolean or an integer.

    Raises NodeError when there is none.
    """
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
    if is_number(nodes, "TLParamsLocked", "integer"):
        with suppress(NodeError):
            hold(nodes, "TLParamsLocked", 0)


def offered(nodes: NodeMap, name: str) -> tuple[str, ...]:
    """The entries that an enumeration can be had at: of a read-only or locked one, that at which it stands."""
    entries = nodes.entries(name)
    if not entries or nodes.writable(name):
        return entries
    present = nodes.read(name)
    return tuple(entry for entry in entries if entry == present)


def fixed_selectors(nodes: NodeMap) -> Iterator[str]:
    """What a read-only selector leaves out, in words."""
    for name in _SELECTORS:
        entries, had = nodes.entries(name), offered(nodes, name)
        others = [entry for entry in entries if entry not in had]
        if others:
            stays_at = ", ".join(had) or "no entry"
            yield f"its {name} is read-only and stays at {stays_at}: left alone are {', '.join(others)}"
