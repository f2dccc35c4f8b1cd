"""A number node as a quantity in our units, whatever unit the camera uses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import sub

from drivers.genicam.nodes import NodeMap
from imaging.errors import NodeError
from imaging.exposure import GainScale

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
