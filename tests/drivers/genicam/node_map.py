"""A node map in memory, for testing the rules that work on nodes without a camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from drivers.genicam.nodes import Kind
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

    def features(self) -> tuple[str, ...]:
        return tuple(self.nodes)

    def streamable(self) -> frozenset[str]:
        return frozenset()

    def kind(self, name: str) -> Kind | None:
        return KINDS[type(self.nodes[name])] if name in self.nodes else None

    def writable(self, name: str) -> bool:
        return not getattr(self.nodes[name], "locked", False)

    def selected(self, name: str) -> tuple[str, ...]:
        node = self.nodes.get(name)
        return node.selected if isinstance(node, EnumerationNode) else ()

    def exists(self, name: str) -> bool:
        return name in self.nodes

    def available(self, name: str) -> bool:
        return name in self.nodes

    def is_float(self, name: str) -> bool:
        return isinstance(self.nodes.get(name), FloatNode)

    def is_integer(self, name: str) -> bool:
        return isinstance(self.nodes.get(name), IntegerNode)

    def unit(self, name: str) -> str | None:
        node = self.nodes.get(name)
        return node.unit if isinstance(node, FloatNode | IntegerNode) else None

    def entries(self, name: str) -> tuple[str, ...]:
        node = self.nodes.get(name)
        return node.entries if isinstance(node, EnumerationNode) else ()

    def float_bounds(self, name: str) -> tuple[float, float]:
        node = self._node(name, FloatNode)
        return node.low, node.high

    def float_increment(self, name: str) -> float:
        return self._node(name, FloatNode).increment

    def integer_bounds(self, name: str) -> tuple[int, int]:
        node = self._node(name, IntegerNode)
        return node.low, node.high

    def integer_increment(self, name: str) -> int:
        return self._node(name, IntegerNode).increment

    def read_float(self, name: str) -> float:
        return self._node(name, FloatNode).value

    def write_float(self, name: str, value: float) -> None:
        node = self._node(name, FloatNode)
        if node.locked or not node.low <= value <= node.high:
            raise NodeError(f"camera {self.serial}: could not set {name} to {value:g}")
        self.writes.append((name, value))
        node.value = node.take(value)

    def read_integer(self, name: str) -> int:
        return self._node(name, IntegerNode).value

    def write_integer(self, name: str, value: int) -> None:
        node = self._node(name, IntegerNode)
        if node.locked or not node.low <= value <= node.high:
            raise NodeError(f"camera {self.serial}: could not set {name} to {value}")
        self.writes.append((name, value))
        node.value = value

    def read_boolean(self, name: str) -> bool:
        return self._node(name, BooleanNode).value

    def write_boolean(self, name: str, value: bool) -> None:
        node = self._node(name, BooleanNode)
        assert not node.locked, name
        self.writes.append((name, value))
        node.value = value

    def read_entry(self, name: str) -> str:
        return self._node(name, EnumerationNode).value

    def write_entry(self, name: str, entry: str) -> None:
        node = self._node(name, EnumerationNode)
        assert entry in node.entries and not node.locked, name
        self.writes.append((name, entry))
        node.value = entry

    def read_string(self, name: str) -> str:
        return self._node(name, StringNode).value

    def write_string(self, name: str, value: str) -> None:
        self.writes.append((name, value))
        self._node(name, StringNode).value = value

    def execute(self, name: str) -> None:
        self._node(name, CommandNode).run()
