"""A node map in memory, for testing the rules that work on nodes without a camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from drivers.errors import NodeError


@dataclass
class FloatNode:
    value: float
    low: float = 0.0
    high: float = 1e6
    unit: str | None = None
    increment: float = 0.0
    take: Callable[[float], float] = lambda value: value
    """What the camera makes of a value written."""


@dataclass
class IntegerNode:
    value: int
    low: int = 0
    high: int = 1 << 62
    unit: str | None = None
    increment: int = 1


@dataclass
class EnumerationNode:
    value: str
    entries: tuple[str, ...]


@dataclass
class BooleanNode:
    value: bool = False


@dataclass
class CommandNode:
    run: Callable[[], None] = lambda: None


Node = FloatNode | IntegerNode | EnumerationNode | BooleanNode | CommandNode

N = TypeVar("N", FloatNode, IntegerNode, EnumerationNode, BooleanNode, CommandNode)


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
        return self._node(name, EnumerationNode).entries if name in self.nodes else ()

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
        if not node.low <= value <= node.high:
            raise NodeError(f"camera {self.serial}: could not set {name} to {value:g}")
        self.writes.append((name, value))
        node.value = node.take(value)

    def read_integer(self, name: str) -> int:
        return self._node(name, IntegerNode).value

    def write_integer(self, name: str, value: int) -> None:
        self.writes.append((name, value))
        self._node(name, IntegerNode).value = value

    def write_boolean(self, name: str, value: bool) -> None:
        self.writes.append((name, value))
        self._node(name, BooleanNode).value = value

    def read_entry(self, name: str) -> str:
        return self._node(name, EnumerationNode).value

    def write_entry(self, name: str, entry: str) -> None:
        assert entry in self.entries(name)
        self.writes.append((name, entry))
        self._node(name, EnumerationNode).value = entry

    def execute(self, name: str) -> None:
        self._node(name, CommandNode).run()
