"""EMVA's reference GenApi reads a fake camera's description over the fake's own memory, beside our evaluator.

`python -m tests.fake_camera.genapi.examiner NAME...` examines descriptions and prints what it finds as JSON. It is a
process of its own, because the reference ends the process (SIGFPE) where a Float is over an Integer of increment 0.
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from genicam import genapi

from fake_camera.device.device import Device
from fake_camera.genapi.access import AccessModes
from fake_camera.genapi.description import REGISTERS, Description, NodeError
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.memory import Memory
from fake_camera.genapi.xml_camera import XmlCamera
from tests.fake_camera.gige.gige_client import Ramp
from tests.xml_cameras import COMBINATIONS, xml_camera
from tests.xml_shapes import DRIVEN, FREE_ONLY, xml_shape

_MOST_BYTES = 0x10000  # of one read
_CLOSE = 1e-9
_NATURAL = {"min": {0, -math.inf}, "max": {math.inf}}


@dataclass
class Findings:
    """What the reference and our evaluator say of one description.

    Attributes
    ----------
    agree
        How often, of values, minima, maxima, increments, units, entries and access modes.
    differ
        Where not: (what, node, ours, theirs).
    refused
        Features that do not take their own value back: (node, why).
    taken
        How many do.
    """

    agree: dict[str, int] = field(default_factory=dict)
    differ: list[tuple[str, str, str, str]] = field(default_factory=list)
    refused: list[tuple[str, str]] = field(default_factory=list)
    taken: int = 0


class Port(genapi.AbstractPort):  # type: ignore[misc]
    """A port of the reference over a memory of ours."""

    def __init__(self, memory: Any) -> None:
        super().__init__()
        self._memory = memory

    def read(self, address: int, count: int) -> bytes:
        if count > _MOST_BYTES:
            raise ValueError(f"{count} bytes at once")
        return bytes(self._memory.read(address, count))

    def write(self, address: int, data: bytes) -> None:
        self._memory.write(address, bytes(data))

    def get_access_mode(self) -> int:
        return int(genapi.EAccessMode.RW)


class Examiner:
    """Both readers of one description over one memory (anything with `read` and `write`) and the ports of chunks."""

    def __init__(self, description: Description, memory: Any, chunks: dict[str, Memory]) -> None:
        self._description = description
        self._ours = Evaluator(description, memory, chunks)
        self._access = AccessModes(self._ours)
        self._theirs = genapi.NodeMap()
        self._theirs.load_xml_from_string(description.data.decode())
        self._ports = {name: Port(port) for name, port in {"Device": memory, **chunks}.items()}  # kept alive
        for name, port in self._ports.items():
            self._theirs.connect(port, name)
        self._agree: Counter[str] = Counter()
        self.findings = Findings()

    def compare(self) -> None:
        """Compare what both say of each node."""
        for name, node in self._description.nodes.items():
            if node.kind not in ("Port", "Category", "EnumEntry"):
                self._compare(name, self._theirs.get_node(name))
        self.findings.agree = dict(self._agree)

    def _compare(self, name: str, theirs: Any) -> None:
        access = _access(theirs)
        self._note("access", name, self._access.of(name), access)
        if isinstance(theirs, genapi.IEnumeration):
            for entry in theirs.entries:
                node = self._ours.node(name).entries[entry.symbolic]
                self._note("entries", f"{name} {entry.symbolic}", self._access.of_entry(node), _access(entry))
                self._note("numbers", f"{name} {entry.symbolic}", node.integer("Value", 0), int(entry.numeric_value))
        if access not in ("RO", "RW") or self._access.of(name) not in ("RO", "RW"):
            return
        if isinstance(theirs, genapi.IInteger | genapi.IFloat | genapi.IEnumeration | genapi.IBoolean | genapi.IString):
            self._note("values", name, self._value(name), _attempt(lambda: _value(theirs)))
        if isinstance(theirs, genapi.IInteger | genapi.IFloat):
            for what, which in (("minima", "Min"), ("maxima", "Max"), ("increments", "Inc")):
                self._limit(what, name, which, theirs)
            units = [node.text("Unit") for node in self._ours.chain(name)]
            self._note("units", name, next(filter(None, units), ""), theirs.unit)

    def _limit(self, what: str, name: str, which: str, theirs: Any) -> None:
        ours = _attempt(lambda: self._ours.bound(name, which))
        if which == "Inc" and isinstance(theirs, genapi.IFloat) and not theirs.has_inc():
            self._note(what, name, ours, None)
        elif ours is not None:  # else as far as the type goes, which is no camera's concern
            self._note(what, name, ours, _attempt(lambda: getattr(theirs, which.lower())))

    def _value(self, name: str) -> Any:
        if self._ours.kind(self._ours.target(name)) == "StringReg":
            data = self._ours.bytes_of(self._ours.field(self._ours.target(name)))
            return data.split(b"\0", 1)[0].decode("latin-1")
        return _attempt(lambda: self._ours.value(name))

    def _note(self, what: str, name: str, ours: Any, theirs: Any) -> None:
        if _same(ours, theirs):
            self._agree[what] += 1
        else:
            self.findings.differ.append((what, name, str(ours), str(theirs)))

    def write_back(self) -> None:
        """Write each feature's own value to it."""
        parts = (node.parts.get("pFeature", []) for node in self._description.nodes.values())
        features = dict.fromkeys((part.text or "").strip() for inside in parts for part in inside)
        for name in features:
            theirs = self._theirs.get_node(name)
            if _access(theirs) != "RW" or isinstance(theirs, genapi.ICommand | genapi.ICategory | genapi.IRegister):
                continue
            try:
                if isinstance(theirs, genapi.IEnumeration):
                    theirs.set_int_value(theirs.get_int_value())
                else:
                    theirs.value = theirs.value
                self.findings.taken += 1
            except (genapi.GenericException, ArithmeticError, ValueError) as error:
                self.findings.refused.append((name, str(error)[:300]))


def _access(node: Any) -> str:
    return {getattr(genapi.EAccessMode, mode): mode for mode in ("NI", "NA", "WO", "RO", "RW")}[
        node.node.get_access_mode()
    ]


def _value(node: Any) -> Any:
    return node.get_int_value() if isinstance(node, genapi.IEnumeration) else node.value


def _attempt(read: Any) -> Any:
    """What it reads; "error" in place of any error."""
    try:
        return read()
    except (genapi.GenericException, NodeError, ArithmeticError, ValueError):
        return "error"


def _same(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, float | int) and isinstance(theirs, float | int):
        return ours == theirs or math.isclose(ours, theirs, rel_tol=_CLOSE) or (math.isnan(ours) and math.isnan(theirs))
    return bool(ours == theirs)


@contextlib.contextmanager
def worn(description: Description) -> Iterator[tuple[XmlCamera, dict[str, Memory]]]:
    """A fake camera that wears a description, and the ports of its chunks."""
    device = Device(Ramp(), "X1")
    try:
        yield (camera := XmlCamera(description, device)), camera.chunk_ports
    finally:
        device.close()


def examine(description: Description) -> Findings:
    """What the reference says of a camera that wears this description, at power-on."""
    with worn(description) as (camera, chunks):
        examiner = Examiner(description, camera, chunks)
        examiner.compare()
        examiner.write_back()
        return examiner.findings


def own() -> dict[str, bytes]:
    """Our own descriptions by name: each combination and each shape."""
    combinations = {f"combination {number}": xml_camera(number) for number in range(len(COMBINATIONS))}
    return combinations | {name: xml_shape(name) for name in DRIVEN | FREE_ONLY}


def main(names: list[str]) -> None:
    """Print the findings on descriptions: files, or ours by name."""
    ours = own()
    found = {}
    for name in names:
        data = ours[name] if name in ours else Path(name).read_bytes()
        found[name] = asdict(examine(Description.from_bytes(data, name)))
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1:])
