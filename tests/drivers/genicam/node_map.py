"""A node map in memory, for testing the rules that work on nodes without a camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from drivers.genicam.nodes import Kind
from drivers.setup import FeatureValue
from imaging.errors import NodeError


@dataclass
class FloatNode:
    value: float
    low: float = 0.0
    high: float = 1e6
    unit: str | None = None
    increment: float = 0.0
    locked: bool = False
    take: Callable[[float], float] = lambda value: value
    """What the camera makes of a value written."""


@dataclass
class IntegerNode:
    value: int
    low: int = 0
    high: int = 1 << 62
    unit: str | None = None
    increment: int = 1
    locked: bool = False


@dataclass
class EnumerationNode:
    value: str
    entries: tuple[str, ...]
    selected: tuple[str, ...] = ()
    locked: bool = False


@dataclass
class BooleanNode:
    value: bool = False
    locked: bool = False


@dataclass
class StringNode:
    value: str


@dataclass
class CommandNode:
    run: Callable[[], None] = lambda: None


Node = FloatNode | IntegerNode | EnumerationNode | BooleanNode | StringNode | CommandNode

N = TypeVar("N", FloatNode, IntegerNode, EnumerationNode, BooleanNode, StringNode, CommandNode)

KINDS: dict[type[Node], Kind] = {
    FloatNode: "float",
    IntegerNode: "integer",
    EnumerationNode: "enumeration",
    BooleanNode: "boolean",
    StringNode: "string",
    CommandNode: "command",
}
TYPES: dict[type[Node], type | tuple[type, ...]] = {
    FloatNode: (float, int),
    IntegerNode: int,
    EnumerationNode: str,
    BooleanNode: bool,
    StringNode: str,
}


@dataclass
class MemoryNodes:
    """Implements drivers.genicam.nodes.NodeMap; `writes` keeps what was written, in order."""

    nodes: dict[str, Node]
    serial: str = "M1"
    writes: list[tuple[str, object]] = field(default_factory=list)

    def _node(self, name: str, kind: type[N]) -> N:
        node = self.nodes[name]
        assert isinstance(node, kind), f"{name} is a {type(node).__name__}"
        return node

    def _number(self, name: str) -> FloatNode | IntegerNode:
        node = self.nodes[name]
        assert isinstance(node, FloatNode | IntegerNode), f"{name} is a {type(node).__name__}"
        return node

    def features(self) -> tuple[str, ...]:
        return tuple(self.nodes)

    def streamable(self) -> frozenset[str]:
        return frozenset()

    def kind(self, name: str) -> Kind | None:
        return KINDS[type(self.nodes[name])] if name in self.nodes else None

    def writable(self, name: str) -> bool:
        return not getattr(self.nodes[name], "locked", False)

    def selected(self, name: str) -> tuple[str, ...]:
        return getattr(self.nodes.get(name), "selected", ())

    def exists(self, name: str) -> bool:
        return name in self.nodes

    def available(self, name: str) -> bool:
        return name in self.nodes

    def unit(self, name: str) -> str | None:
        return getattr(self.nodes.get(name), "unit", None)

    def entries(self, name: str) -> tuple[str, ...]:
        return getattr(self.nodes.get(name), "entries", ())

    def bounds(self, name: str) -> tuple[float, float]:
        return self._number(name).low, self._number(name).high

    def increment(self, name: str) -> float:
        return self._number(name).increment

    def read(self, name: str) -> FeatureValue:
        node = self.nodes[name]
        assert not isinstance(node, CommandNode), name
        return node.value

    def write(self, name: str, value: FeatureValue) -> None:
        node = self.nodes[name]
        assert isinstance(value, TYPES[type(node)]), (name, value)
        if isinstance(node, FloatNode | IntegerNode) and (node.locked or not node.low <= value <= node.high):  # type: ignore[operator]
            raise NodeError(f"camera {self.serial}: could not set {name} to {value:g}")
        assert not getattr(node, "locked", False) and value in getattr(node, "entries", (value,)), name
        self.writes.append((name, value))
        node.value = node.take(value) if isinstance(node, FloatNode) else value  # type: ignore[union-attr, arg-type, assignment]

    def execute(self, name: str) -> None:
        self._node(name, CommandNode).run()
