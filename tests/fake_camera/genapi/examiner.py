"""EMVA's reference GenApi reads a fake camera's description over the fake's own memory, beside our evaluator.

`python -m tests.fake_camera.genapi.examiner NAME...` examines descriptions and prints what it finds as JSON. It is a
process of its own, because the reference ends the process (SIGFPE) where a Float is over an Integer of increment 0.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from genicam import genapi

from fake_camera.device.device import Device
from fake_camera.genapi.access import AccessModes
from fake_camera.genapi.description import Description, NodeError
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.memory import Memory
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genicam.description import genicam_xml
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.status import CommandError
from fake_camera.gige.bootstrap import GIGE_VISION
from fake_camera.gige.server import GigeServer
from fake_camera.usb3.bootstrap import USB3_VISION
from fake_camera.usb3.usb_device import UsbDevice
from tests.fake_camera.gige.gige_client import Ramp
from tests.fakes import loopback_address
from tests.xml_cameras import COMBINATIONS, document, xml_camera
from tests.xml_shapes import DRIVEN, FREE_ONLY, xml_shape

_MOST_BYTES = 0x10000  # of one read
_ALIGNMENT = 4  # of what GigE Vision cameras read and write
_CLOSE = 1e-9


@dataclass
class Findings:
    """What the reference and our evaluator say of one description.

    Attributes
    ----------
    agree
        How often, of values, minima, maxima, increments, units, entries and access modes.
    differ
        Where not: (what, node, ours, theirs).
    usable
        How many features can be read and, where they can be written, take their own value back.
    unusable
        Those that cannot or do not: (feature, why).
    """

    agree: dict[str, int] = field(default_factory=dict)
    differ: list[tuple[str, str, str, str]] = field(default_factory=list)
    usable: int = 0
    unusable: list[tuple[str, str]] = field(default_factory=list)


class Port(genapi.AbstractPort):  # type: ignore[misc]
    """A port of the reference over a memory of ours."""

    def __init__(self, memory: Any) -> None:
        super().__init__()
        self._memory = memory

    def read(self, address: int, count: int) -> bytes:
        return bytes(self._memory.read(address, count))

    def write(self, address: int, data: bytes) -> None:
        self._memory.write(address, bytes(data))

    def get_access_mode(self) -> int:
        return int(genapi.EAccessMode.RW)


class Still:
    """A memory in which no time passes between two reads, and of which any bytes may be read and written."""

    def __init__(self, memory: Any) -> None:
        self._memory = memory
        self._words = functools.cache(memory.read)

    def read(self, address: int, count: int) -> bytes:
        if count > _MOST_BYTES:
            raise ValueError(f"{count} bytes at once")
        before = address % _ALIGNMENT
        data = self._words(address - before, -(-(before + count) // _ALIGNMENT) * _ALIGNMENT)
        return bytes(data[before : before + count])

    def write(self, address: int, data: bytes) -> None:
        before, after = address % _ALIGNMENT, -(address + len(data)) % _ALIGNMENT
        whole = self.read(address - before, before) + data + self.read(address + len(data), after)
        self._words.cache_clear()
        self._memory.write(address - before, whole)


class Examiner:
    """Both readers of one description over one memory (anything with `read` and `write`) and the ports of chunks."""

    def __init__(self, description: Description, memory: Any, chunks: dict[str, Memory]) -> None:
        self._description = description
        memory = Still(memory)
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
        if isinstance(theirs, _WITH_VALUE):
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
        if same(ours, theirs):
            self._agree[what] += 1
        else:
            self.findings.differ.append((what, name, str(ours), str(theirs)))

    def use(self) -> None:
        """Read each feature that there is, and write its own value to it."""
        parts = (node.parts.get("pFeature", []) for node in self._description.nodes.values())
        for name in dict.fromkeys((part.text or "").strip() for inside in parts for part in inside):
            theirs = self._theirs.get_node(name)
            access = _access(theirs)
            if access not in ("RO", "RW") or not isinstance(theirs, _WITH_VALUE):
                continue
            try:
                value = _value(theirs)
                if access == "RW" and isinstance(theirs, genapi.IEnumeration):
                    theirs.set_int_value(value)
                elif access == "RW":
                    theirs.value = value
                self.findings.usable += 1
            except (genapi.GenericException, CommandError, ArithmeticError, ValueError) as error:
                self.findings.unusable.append((name, str(error)[:300]))


_WITH_VALUE = (genapi.IInteger, genapi.IFloat, genapi.IEnumeration, genapi.IBoolean, genapi.IString)


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
    except (genapi.GenericException, CommandError, NodeError, ArithmeticError, ValueError):
        return "error"


def same(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, float | int) and isinstance(theirs, float | int):
        clamped = min(max(ours, -sys.float_info.max), sys.float_info.max)  # as far as their limits go
        return (
            theirs in (ours, clamped)
            or math.isclose(ours, theirs, rel_tol=_CLOSE)
            or (math.isnan(ours) and math.isnan(theirs))
        )
    return bool(ours == theirs)


@contextlib.contextmanager
def examined(description: Description | None, transport: str) -> Iterator[Examiner]:
    """Both readers of a fake camera on a transport, with a description or its own."""
    device = Device(Ramp(), "X1")
    camera = None if description is None else XmlCamera(description, device)
    with contextlib.closing(device), contextlib.ExitStack() as served:
        if transport == "gige":
            server = served.enter_context(contextlib.closing(GigeServer(device, address := loopback_address(), camera)))
            registers = server._registers(address, ControlPrivilege())
        else:
            registers = UsbDevice(device, camera)._registers()
        if description is None:
            text = genicam_xml(device.features, GIGE_VISION if transport == "gige" else USB3_VISION)
            description = Description.from_bytes(text, transport)
        chunks = {name: Memory() for name, node in description.nodes.items() if "ChunkID" in node.parts}
        yield Examiner(description, registers, chunks if camera is None else camera.chunk_ports)


def examine(description: Description | None, transport: str) -> Findings:
    """What the reference says of a fake camera at power-on."""
    with examined(description, transport) as examiner:
        examiner.compare()
        examiner.use()
        return examiner.findings


def value_of_formula(text: str, integer: bool) -> Any:
    """What the reference makes of a formula without variables; "error" if it has no value."""
    kind = "IntSwissKnife" if integer else "SwissKnife"
    nodes = genapi.NodeMap()
    nodes.load_xml_from_string(
        document("M", "GEV", [f'<{kind} Name="K_"><Formula>{escape(text)}</Formula></{kind}>']).decode()
    )
    return _attempt(lambda: nodes.get_node("K_").value)


def own() -> dict[str, bytes | None]:
    """Our own descriptions by name: each combination and each shape, and None for those of the fakes themselves."""
    combinations = {f"combination {number}": xml_camera(number) for number in range(len(COMBINATIONS))}
    return combinations | {name: xml_shape(name) for name in DRIVEN | FREE_ONLY} | {"gige": None, "usb3": None}


def main(names: list[str]) -> None:
    """Print the findings on descriptions: files, or ours by name."""
    ours = own()
    found = {}
    for name in names:
        data = ours[name] if name in ours else Path(name).read_bytes()
        description = None if data is None else Description.from_bytes(data, name)
        usb3 = name == "usb3" or (description is not None and description.standard == "U3V")
        found[name] = asdict(examine(description, "usb3" if usb3 else "gige"))
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1:])
