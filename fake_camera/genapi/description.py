"""A GenICam description, as a table of nodes by name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element, ParseError, fromstring

REGISTERS = ("IntReg", "MaskedIntReg", "FloatReg", "StringReg", "Register", "StructEntry")
_BELOW_STRUCT = ("StructEntry",)
_REFERENCES = ("pVariable", "pAddress", "pLength", "pMin", "pMax", "pInc", "pCommandValue", "pValueCopy")
_START = re.compile(rb"<\?xml|<RegisterDescription")
_LONGEST_NUMBER = 64  # characters: numbers have 64 bits


class NodeError(ValueError):
    """A node that has no value or cannot be set: missing, circular, or not understood here."""


def whole_number(text: str) -> int:
    """The number in `text`, in decimal or as 0x...; raises NodeError when there is none."""
    try:
        return int(text[:_LONGEST_NUMBER], 16 if "x" in text.lower() else 10)
    except ValueError:
        raise NodeError(f"{text[:_LONGEST_NUMBER]!r} is not a whole number") from None


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """One node: its kind (the name of its element), its name, and the elements in it, those of an outer StructReg last.

    An element may occur several times (Address, pVariable); the node's own comes before that of the StructReg.
    """

    name: str
    kind: str
    parts: dict[str, list[Element]]

    def text(self, tag: str, default: str = "") -> str:
        """The text of the first element `tag`, `default` where there is none."""
        parts = self.parts.get(tag)
        return (parts[0].text or "").strip() if parts else default

    def integer(self, tag: str, default: int) -> int:
        """The number in the first element `tag`, written in decimal or as 0x..."""
        text = self.text(tag)
        return whole_number(text) if text else default

    @property
    def references(self) -> tuple[str, ...]:
        """The nodes that its formulas, its address and length, and its limits refer to."""
        inside = [part for outer in self.parts.get("IntSwissKnife", []) for part in outer.iter("pVariable")]
        indices = self.parts.get("pIndex", [])
        parts = [*inside, *indices, *(part for tag in _REFERENCES for part in self.parts.get(tag, []))]
        offsets = [part.attrib["pOffset"] for part in indices if "pOffset" in part.attrib]
        return (*((part.text or "").strip() for part in parts), *offsets)

    @property
    def entries(self) -> dict[str, Node]:
        """The entries of an enumeration."""
        return {entry.name: entry for entry in map(_node, self.parts.get("EnumEntry", []))}


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A whole description: who the camera is, and its nodes.

    Attributes
    ----------
    data
        The description itself, as a camera serves it.
    """

    data: bytes
    vendor: str
    model: str
    namespace: str
    nodes: dict[str, Node]

    @classmethod
    def from_bytes(cls, text: bytes, source: str) -> Description:
        """Read a description; text before it, such as a camera's name, is skipped.

        Raises ValueError when it is not a GenICam description; the message names `source` as the file.
        """
        start = _START.search(text)
        data = text[start.start() if start else 0 :].strip()
        try:
            root = fromstring(data)
        except (ParseError, LookupError, ValueError) as error:  # an unknown encoding among them
            raise ValueError(f"{source}: not an XML file ({error}); give the GenICam description of a camera") from None
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]
        if root.tag != "RegisterDescription":
            raise ValueError(
                f"{source}: a GenICam description begins with RegisterDescription, this one with {root.tag}"
            )
        nodes: dict[str, Node] = {}
        try:
            _collect(root, nodes)
        except RecursionError:
            raise ValueError(f"{source}: its groups are nested too deeply for a GenICam description") from None
        return cls(
            data, root.get("VendorName", ""), root.get("ModelName", ""), root.get("StandardNameSpace", ""), nodes
        )

    @property
    def standard(self) -> Literal["GEV", "U3V"] | None:
        """Which standard the camera follows, GigE Vision or USB3 Vision; None when the description does not say.

        If it names neither, its registers decide: mostly little-endian ones mean USB3 Vision; otherwise features
        called Gev... mean GigE Vision.
        """
        if self.namespace in ("USB", "U3V"):  # by the schema, and as some write it
            return "U3V"
        if self.namespace == "GEV":
            return "GEV"
        orders = [node.text("Endianess") for node in self.nodes.values() if node.text("pPort") == "Device"]
        if 2 * orders.count("LittleEndian") > len(orders):
            return "U3V"
        return "GEV" if any(name.startswith("Gev") for name in self.nodes) else None


def _collect(parent: Element, nodes: dict[str, Node]) -> None:
    for element in parent:
        if element.tag == "Group":
            _collect(element, nodes)
        elif element.tag == "StructReg":
            for entry in element.findall("StructEntry"):
                node = _node(entry, element)
                nodes[node.name] = node
        elif name := element.get("Name"):
            nodes[name] = _node(element)


def _node(element: Element, outer: Element | None = None) -> Node:
    parts: dict[str, list[Element]] = {}
    for child in (*element, *(() if outer is None else outer)):
        if child.tag not in _BELOW_STRUCT:
            parts.setdefault(child.tag, []).append(child)
    return Node(element.get("Name", ""), element.tag, parts)
