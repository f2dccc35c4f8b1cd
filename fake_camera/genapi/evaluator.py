"""The values of nodes: read from registers through formulas, and written back the other way."""

from __future__ import annotations

import contextlib
import functools
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Concatenate, ParamSpec, TypeVar

from fake_camera.genapi.description import REGISTERS, Description, Node, NodeError, whole_number
from fake_camera.genapi.field import Field
from fake_camera.genapi.formula import FormulaError, Number, compile_formula, rounded
from fake_camera.genapi.memory import Memory

_WHOLE = ("Integer", "IntReg", "MaskedIntReg", "StructEntry", "IntSwissKnife", "IntConverter", "Enumeration", "Boolean")
_BOUNDS = {"pMin", "pMax", "Min", "Max"}
_CONVERTERS = ("Converter", "IntConverter")
_DEEPEST = 64  # nodes in a chain of references: more means a circle
_LONGEST_REGISTER = 1 << 16  # bytes: longer than any register of a camera, look-up tables included
_MOST_STEPS = 2_000  # nodes evaluated for one value: no description that we know needs more than 441

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def _raising_node_errors(
    method: Callable[Concatenate[Evaluator, str, Arguments], Result],
) -> Callable[Concatenate[Evaluator, str, Arguments], Result]:
    """Turn errors from numbers out of range, circles and meaningless texts into NodeErrors."""

    @functools.wraps(method)
    def wrapped(evaluator: Evaluator, name: str, /, *arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        try:
            return method(evaluator, name, *arguments, **named)
        except NodeError:
            raise
        except (ValueError, ArithmeticError, RecursionError, struct.error) as error:
            raise NodeError(f"node {name}: {error}") from None

    return wrapped


class Evaluator:
    """Values of the nodes of a description over a camera's memory. Not thread-safe.

    `ports` are further memories by the name of their Port, such as those of chunk data. Nodes that hold a value
    themselves instead of in a register belong to the client: here they keep the description's value, except within
    `selecting`.
    """

    def __init__(self, description: Description, memory: Memory, ports: dict[str, Memory] | None = None) -> None:
        self._nodes = description.nodes
        self._memory = memory
        self._ports = ports or {}
        self._in_register: dict[str, list[str]] = {}
        for name, node in self._nodes.items():
            if node.kind in ("Integer", "Float") and _BOUNDS & node.parts.keys():
                self._in_register.setdefault(self._register_of(node), []).append(name)
        self._chosen: dict[str, Number] = {}
        self._seen: dict[str, Field] = {}
        self._depth = 0
        self._steps = 0

    def node(self, name: str) -> Node:
        """The node of that name; raises NodeError when there is none."""
        try:
            return self._nodes[name]
        except KeyError:
            raise NodeError(f"no node {name}") from None

    @property
    def nodes(self) -> Mapping[str, Node]:
        """All nodes by name."""
        return self._nodes

    def kind(self, name: str) -> str | None:
        """The kind of a node, None when there is none of that name."""
        return self._nodes[name].kind if name in self._nodes else None

    @_raising_node_errors
    def value(self, name: str) -> Number:
        """The value of a node; an enumeration's is a number, a boolean's 0 or 1.

        Raises NodeError when the node has no value.
        """
        if name in self._chosen:
            return self._chosen[name]
        if self._depth > _DEEPEST:
            raise NodeError(f"node {name} depends on itself")
        self._steps = self._steps + 1 if self._depth else 0
        if self._steps > _MOST_STEPS:
            raise NodeError(f"node {name} takes too many steps to evaluate")
        self._depth += 1
        try:
            return self._value(self.node(name))
        finally:
            self._depth -= 1

    def has_value(self, name: str) -> bool:
        """Whether a node has a value."""
        with contextlib.suppress(NodeError):
            self.value(name)
            return True
        return False

    def fields(self, name: str) -> dict[str, Field]:
        """The registers that the value of a node depends on at present, by the names of their nodes."""
        self._seen = {}
        with contextlib.suppress(NodeError):
            self.value(name)
        return dict(self._seen)  # the next value may depend on others: a formula need not use all its variables

    @_raising_node_errors
    def chain(self, name: str) -> tuple[Node, ...]:
        """A node and those behind it, which must all be available for the first to be."""
        nodes = [self.node(name)]
        while (behind := self.behind(nodes[-1])) is not None:
            if len(nodes) > _DEEPEST:
                raise NodeError(f"node {name} depends on itself")
            nodes.append(self.node(behind))
        return tuple(nodes)

    def referred(self, node: Node) -> tuple[str, ...]:
        """The nodes that must be readable for this one: behind it, in its formulas, its address and its limits."""
        behind = self.behind(node)
        return node.references if behind is None else (*node.references, behind)

    def is_served(self, port: str) -> bool:
        """Whether somebody answers at a port: those of events are served to nobody."""
        return port in self._ports or port not in self._nodes or "EventID" not in self._nodes[port].parts

    @_raising_node_errors
    def sources(self, name: str) -> tuple[Node, ...]:
        """A node and all that must be readable for it to have a value: behind it, in its formulas, in its address."""
        nodes = {name: self.node(name)}
        waiting = [name]
        while waiting:
            for source in self.referred(nodes[waiting.pop()]):
                if source not in nodes:
                    nodes[source] = self.node(source)
                    waiting.append(source)
        return tuple(nodes.values())

    def target(self, name: str) -> str:
        """The node that holds the value of `name`, behind its pValue and its index; itself where one is missing."""
        try:
            return self.chain(name)[-1].name
        except NodeError:
            return name

    @_raising_node_errors
    def field(self, name: str) -> Field:
        """Where the register of a node is at present."""
        return self._field(self.node(name))

    def bytes_of(self, field: Field) -> bytes:
        """The present bytes of a register."""
        return self._port(field).read(field.address, field.length)

    def write(self, field: Field, data: bytes) -> None:
        """Store the bytes of a register."""
        self._port(field).write(field.address, data)

    @_raising_node_errors
    def set(self, name: str, value: Number) -> None:
        """Set a node through its pValue and the formulas of its converters, down to a register.

        Raises NodeError when there is no way to a register: a SwissKnife, or a node that belongs to the client.
        """
        node = self.node(name)
        if node.kind in REGISTERS:
            field = self._field(node)
            self.write(field, field.encode(value, self.bytes_of(field)))
            return
        behind = self.behind(node)
        if behind is None:
            raise NodeError(f"node {name} cannot be set")
        if node.kind in _CONVERTERS:
            self.set(behind, self._formula(node, "FormulaTo", "FROM", value))
        elif node.kind == "Boolean":
            self.set(behind, node.integer("OnValue", 1) if value else node.integer("OffValue", 0))
        else:
            self.set(behind, rounded(value) if node.kind in _WHOLE else value)

    @contextlib.contextmanager
    def selecting(self, selector: str, value: int) -> Iterator[None]:
        """Within the block the selector, and the nodes behind it, are at `value`, whatever its registers say."""
        chosen: dict[str, Number] = {selector: value}
        with contextlib.suppress(NodeError):
            for node in self.chain(selector):
                chosen[node.name] = value
                if node.kind in _CONVERTERS:
                    value = int(self._formula(node, "FormulaTo", "FROM", value))
        before, self._chosen = self._chosen, {**self._chosen, **chosen}
        try:
            yield
        finally:
            self._chosen = before

    def selecting_entry(self, selector: str, entry: str) -> contextlib.AbstractContextManager[None]:
        """Like `selecting`, by the name of the entry; does nothing where there is no such selector or entry."""
        entries = self._nodes[selector].entries if self.kind(selector) == "Enumeration" else {}
        return (
            self.selecting(selector, entries[entry].integer("Value", 0))
            if entry in entries
            else contextlib.nullcontext()
        )

    @_raising_node_errors
    def bound(self, name: str, which: str) -> Number | None:
        """The Min, Max or Inc (`which`) of a number, its own or that of the node behind it; None when not declared."""
        node = self.node(name)
        limit = self._bound(node, which)
        return limit if limit is None or not self.is_whole(name) else rounded(limit)

    def _bound(self, node: Node, which: str) -> Number | None:
        if f"p{which}" in node.parts:
            return self.value(node.text(f"p{which}"))
        if which in node.parts:
            return _number(node.text(which))
        behind = self.behind(node)
        converts = node.kind in _CONVERTERS
        if which == "Inc" and (behind is None or converts):
            return 1 if node.kind in _WHOLE else None
        if behind is None or node.kind == "Enumeration":
            return None
        if not converts:
            return self.bound(behind, which)
        slope = node.text("Slope", "Automatic")
        return None if slope == "Varying" else self._converted(node, behind, which, slope)

    def _converted(self, node: Node, behind: str, which: str, slope: str) -> Number | None:
        """A limit through a converter, which swaps them if it falls."""

        def end(which: str) -> Number | None:
            limit = self.bound(behind, which)
            return None if limit is None else self._formula(node, "FormulaFrom", "TO", limit)

        other = {"Min": "Max", "Max": "Min"}[which]
        if slope != "Automatic":
            return end(other if slope == "Decreasing" else which)
        low, high = end("Min"), end("Max")
        falls = low is not None and high is not None and low > high
        return high if falls == (which == "Min") else low

    def limits(self, name: str) -> tuple[Number, Number]:
        """Lowest and highest value of a number; infinite where not declared."""
        low, high = self.bound(name, "Min"), self.bound(name, "Max")
        return float("-inf") if low is None else low, float("inf") if high is None else high

    def holds(self, register: str) -> bool:
        """Whether the numbers that are in a register are within the limits that they declare."""
        for name in self._in_register.get(register, ()):
            with contextlib.suppress(NodeError):
                low, high = self.limits(name)
                if low < high and not low <= self.value(name) <= high:
                    return False
        return True

    def limit_node(self, name: str, which: str) -> str:
        """The node that is the limit of a number, or of the one behind it without a formula between; else empty."""
        for node in self.chain(name):
            if f"p{which}" in node.parts or which in node.parts or node.kind in _CONVERTERS:
                return node.text(f"p{which}")
        return ""

    def _register_of(self, node: Node) -> str:
        """The last node behind one, by pValue alone."""
        for _ in range(_DEEPEST):
            if node.text("pValue") not in self._nodes:
                break
            node = self._nodes[node.text("pValue")]
        return node.name

    def is_whole(self, name: str) -> bool:
        """Whether a number has no fraction."""
        return self.kind(name) in _WHOLE

    @_raising_node_errors
    def bounded(self, name: str, value: Number) -> tuple[str, Number]:
        """The node at or behind `name` that declares bounds (else the last one), and `value` in its own terms."""
        node = self.node(name)
        behind = self.behind(node)
        if behind is None or _BOUNDS & node.parts.keys():
            return name, value
        if node.kind in _CONVERTERS:
            value = self._formula(node, "FormulaTo", "FROM", value)
        return self.bounded(behind, value)

    def _value(self, node: Node) -> Number:
        if node.kind in REGISTERS:
            field = self._field(node)
            self._seen[node.name] = field
            return field.decode(self.bytes_of(field))
        if node.kind in ("SwissKnife", "IntSwissKnife"):
            return self._formula(node, "Formula")
        behind = self.behind(node)
        if behind is None:
            if "Value" not in node.parts and "ValueDefault" not in node.parts:
                raise NodeError(f"node {node.name} has no value")
            return _number(self._indexed_value(node))
        value = self.value(behind)
        if node.kind in _CONVERTERS:
            return self._formula(node, "FormulaFrom", "TO", value)
        if node.kind == "Boolean":
            on, off = node.integer("OnValue", 1), node.integer("OffValue", 0)
            if value not in (on, off):
                raise NodeError(f"node {node.name}: {value} is neither {on} nor {off}")
            return int(value == on)
        return rounded(value) if node.kind in _WHOLE else value

    def behind(self, node: Node) -> str | None:
        """The node that holds the value of this one, if another does."""
        if "pIndex" in node.parts and node.kind not in REGISTERS:
            index = int(self.value(node.text("pIndex")))
            for part in node.parts.get("pValueIndexed", []):
                if whole_number(part.get("Index", "-1")) == index:
                    return (part.text or "").strip()
            return node.text("pValueDefault") or None
        return node.text("pValue") or None

    def _indexed_value(self, node: Node) -> str:
        if "pIndex" in node.parts:
            index = int(self.value(node.text("pIndex")))
            for part in node.parts.get("ValueIndexed", []):
                if whole_number(part.get("Index", "-1")) == index:
                    return (part.text or "").strip()
            return node.text("ValueDefault", "0")
        return node.text("Value")

    def _formula(self, node: Node, tag: str, given: str = "", value: Number = 0) -> Number:
        """Evaluate a formula of a node with its variable `given` set to `value`."""
        known = {part.get("Name", ""): (part.text or "").strip() for part in node.parts.get("pVariable", [])}
        constants = {part.get("Name", ""): part.text or "" for part in node.parts.get("Constant", [])}
        expressions = {part.get("Name", ""): part.text or "" for part in node.parts.get("Expression", [])}
        integer = node.kind in _WHOLE
        whole = rounded if integer else (lambda number: number)
        values: dict[str, Number] = {given: whole(value)}  # some formulas use one variable a hundred times

        def variable(name: str) -> Number:
            if name in values:
                return values[name]
            if name in known:
                return values.setdefault(name, whole(self._variable(known[name], name.partition(".")[2])))
            if name in constants:
                return _number(constants[name])
            if name in expressions:
                return values.setdefault(name, compile_formula(expressions[name].strip(), integer)(variable))
            raise FormulaError(f"unknown variable {name}")

        try:
            result = compile_formula(node.text(tag), integer)(variable)
            result = rounded(result) if integer else result
        except NodeError:
            raise
        except (ValueError, ArithmeticError, RecursionError) as error:
            raise NodeError(f"formula of node {node.name}: {error}") from error
        return result

    def _variable(self, name: str, what: str) -> Number:
        """What a variable of a formula stands for: the value of its node, or what the variable's own name ends in."""
        if what in ("Min", "Max", "Inc"):
            limit = self.bound(name, what)
            if limit is None:
                raise NodeError(f"node {name} has no {what}")
            return limit
        if what.startswith("Entry."):
            return self.node(name).entries[what.removeprefix("Entry.")].integer("Value", 0)
        return self.value(name)

    def _field(self, node: Node) -> Field:
        length = int(self.value(node.text("pLength"))) if "pLength" in node.parts else node.integer("Length", 4)
        little_endian = node.text("Endianess", "LittleEndian") == "LittleEndian"
        shift, bits = 0, 8 * length
        if "Bit" in node.parts or "LSB" in node.parts:
            lsb = node.integer("LSB", node.integer("Bit", 0))
            msb = node.integer("MSB", node.integer("Bit", 0))
            bits = abs(msb - lsb) + 1
            # Big-endian descriptions count bits from the highest one, as GigE Vision draws its registers.
            shift = min(lsb, msb) if little_endian else 8 * length - 1 - max(lsb, msb)
        floating = node.kind == "FloatReg"
        if not 0 < length <= _LONGEST_REGISTER or not 0 <= shift <= shift + bits <= 8 * length:
            raise NodeError(f"node {node.name}: bits {shift} to {shift + bits} of a register of {length} bytes")
        if floating and length not in (4, 8):
            raise NodeError(f"node {node.name}: a float cannot have {length} bytes")
        return Field(
            node.text("pPort"), self._address(node, length), length, shift, bits, node.text("Sign") == "Signed",
            little_endian, floating,
        )  # fmt: skip

    def _address(self, node: Node, length: int) -> int:
        """The sum of everything that contributes to the address of a register."""
        address = sum(whole_number((part.text or "0").strip()) for part in node.parts.get("Address", []))
        address += sum(int(self.value((part.text or "").strip())) for part in node.parts.get("pAddress", []))
        for part in node.parts.get("IntSwissKnife", []):
            inline = Node("", "IntSwissKnife", {})
            for child in part:
                inline.parts.setdefault(child.tag, []).append(child)
            address += int(self._formula(inline, "Formula"))
        for part in node.parts.get("pIndex", []):
            offset = whole_number(part.get("Offset", "0")) or length
            if "pOffset" in part.attrib:
                offset = int(self.value(part.attrib["pOffset"]))
            address += offset * int(self.value((part.text or "").strip()))
        return address

    def _port(self, field: Field) -> Memory:
        if not self.is_served(field.port):
            raise NodeError(f"nobody serves the port {field.port}")
        return self._ports.get(field.port, self._memory)


def _number(text: str) -> Number:
    """The number in a text of a description."""
    text = text.strip()
    try:
        return whole_number(text) if text else 0
    except NodeError:
        return float(text)
