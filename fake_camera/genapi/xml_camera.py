"""A device that wears the GenICam description of a real camera: its memory, and what writes to it cause."""

from __future__ import annotations

import contextlib
import threading

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault
from fake_camera.device.feature_table import CHUNK_TRAILER_BYTES
from fake_camera.device.features import FeatureError
from fake_camera.genapi.description import REGISTERS, Description, NodeError
from fake_camera.genapi.dialect import CHUNK_CONTENTS, LIVE_COMMANDS, frame_trigger, trigger_lines
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.field import Field
from fake_camera.genapi.memory import Fixed, Memory
from fake_camera.genapi.raw_gain import RawGainLaw
from fake_camera.genapi.solve import assign
from fake_camera.genapi.xml_features import Animation, Watch
from fake_camera.genapi.xml_power_on import power_on
from fake_camera.genapi.xml_ptp import LATCHES, show_data_set
from fake_camera.imaging import ExposedFrame

_BANKS = {
    "TriggerSelector": ("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerOverlap"),
    "GainSelector": ("Gain", "GainAbs", "GainRaw", "GainAuto"),
    "ChunkSelector": ("ChunkEnable",),
}
_IDENTITY = {
    "DeviceVendorName": "DeviceVendorName", "DeviceModelName": "DeviceModelName",
    "DeviceSerialNumber": "DeviceSerialNumber", "DeviceID": "DeviceSerialNumber",
}  # fmt: skip
"""Features that identify the device, by the names of the nodes that may hold them."""


class XmlCamera:
    """The memory of a described camera. Thread-safe and independent of the transport: addresses in, bytes out.

    Attributes
    ----------
    description
        The description that it wears.
    not_available
        Wanted features that stay unavailable, because no register contents were found that unlock them.
    chunk_ports
        What the description reads of the last frame's chunk data, by the names of its ports.

    `raw_gain` is the law of a gain that is not in dB.
    """

    def __init__(self, description: Description, device: Device, raw_gain: RawGainLaw = "decibels") -> None:
        self.description = description
        self._raw_gain = raw_gain
        self._device = device
        self._fixed: Fixed = lambda address, count: None
        self._lock = threading.RLock()
        chunk_ports = (name for name, node in description.nodes.items() if "ChunkID" in node.parts)
        self.chunk_ports = {name: Memory() for name in chunk_ports}
        self._power_on()
        device.on_power_on(self._power_on)

    @property
    def trigger_line(self) -> str | None:
        """The trigger line that the wire is plugged into, by the camera's own name."""
        return next(iter(trigger_lines(self._evaluator)), None)

    @property
    def payload_bytes(self) -> int:
        """Bytes of an image and its chunk data."""
        with self._lock:
            return int(self._device.features.get("PayloadSize")) + self._chunk_bytes()

    def address(self, name: str) -> int | None:
        """The address of the register of a node; None when there is none."""
        with self._lock:
            return next((field.address for field in self._evaluator.fields(name).values()), None)

    def entries(self, name: str) -> dict[str, int]:
        """The entries of an enumeration with their numbers; none if the camera does not have it."""
        with self._lock:
            if self._evaluator.kind(name) != "Enumeration":
                return {}
            return {entry: node.integer("Value", 0) for entry, node in self._evaluator.node(name).entries.items()}

    def place(self, fixed: Fixed) -> None:
        """Put the camera behind a wire whose own registers are read with `fixed` (see `Memory`)."""
        self._fixed = fixed
        self._power_on()

    def read(self, address: int, count: int) -> bytes:
        """Read memory; zeros where nothing was ever written."""
        with self._lock:
            self._show_latch()
            return self._memory.read(address, count)

    def write(self, address: int, data: bytes) -> None:
        """Write memory, with the effects of the registers written.

        Raises FeatureError: "locked" by an ordered fault; "out_of_range" when a number would leave its limits.
        """
        if self._device.faults.spoils_command(Fault.REFUSE_WRITES):
            raise FeatureError("locked", "writes are refused, as ordered")
        if self._device.faults.spoils_command(Fault.STICK):
            return
        with self._lock:
            before = self._memory.read(address, len(data))
            selected = {selector: self._evaluator.value(selector) for selector in self._banked}
            self._memory.write(address, data)
            touched = [watch for watch in self._watches if watch.touched_by(address, len(data))]
            try:
                for watch in touched:
                    watch.check()
            except FeatureError:
                self._memory.write(address, before)
                raise
            self._run_commands(address, len(data))
            self._change_banks(selected)
            for watch in touched:
                watch.apply()
            self._show_payload()

    def chunks(self, frame: ExposedFrame) -> list[tuple[int, bytes]] | None:
        """Id and data of each enabled chunk, in order; None while chunk data are off."""
        with self._lock:
            if not self._animation.chunk_mode:
                return None
            return [self._chunk(entry, frame) for entry in self._animation.enabled_chunks]

    def _chunk(self, entry: str, frame: ExposedFrame) -> tuple[int, bytes]:
        port, chunk_id = self._chunk_port(entry)
        value = self._animation.chunk_value(CHUNK_CONTENTS[entry], frame)
        known = self._chunk_data.get(entry)
        if known is None or known[0] != value:
            assign(self._evaluator, f"Chunk{entry}", value)
            known = value, self.chunk_ports[port].read(0, self._chunk_size(port))
            self._chunk_data[entry] = known
        return chunk_id, known[1]

    def _power_on(self) -> None:
        with self._lock:
            features = self._device.features
            features.update("DeviceVendorName", self.description.vendor)
            features.update("DeviceModelName", self.description.model)
            self._memory = Memory(self._fixed)
            self._evaluator = Evaluator(self.description, self._memory, self.chunk_ports)
            width, height = int(features.get("SensorWidth")), int(features.get("SensorHeight"))
            self.not_available = power_on(self._evaluator, width, height)
            self._identify()
            self._banked = {
                selector: tuple(name for name in names if self._is_banked(selector, name))
                for selector, names in _BANKS.items()
                if self._is_selector_register(selector)
            }
            self._banks: dict[tuple[str, int], bytes] = {}
            self._chunk_data: dict[str, tuple[float, bytes]] = {}
            self._latched_ns: int | None = None
            self._animation = Animation(self._evaluator, features, self._banked, self._raw_gain)
            self._watches: list[Watch] = self._animation.watches
            self._commands = self._find_commands()
            for watch in self._watches:
                watch.apply()
            self._show_payload()
            if features.has_ptp:
                show_data_set(self._evaluator, features)

    def _identify(self) -> None:
        """Write vendor, model and serial number where the description keeps them outside the bootstrap registers."""
        for name, feature in _IDENTITY.items():
            register = self._evaluator.target(name)
            if self._evaluator.kind(register) != "StringReg":
                continue
            with contextlib.suppress(NodeError):
                field = self._evaluator.field(register)
                text = str(self._device.features.get(feature)).encode()[: field.length]
                self._evaluator.write(field, text.ljust(field.length, b"\0"))

    def _is_selector_register(self, selector: str) -> bool:
        kind = self._evaluator.kind(selector)
        return kind == "Enumeration" and self._evaluator.kind(self._evaluator.target(selector)) in REGISTERS

    def _is_banked(self, selector: str, name: str) -> bool:
        """Whether a feature has one address for all entries of its selector: the camera itself then swaps the value."""
        if self._evaluator.kind(name) in (None, "Category"):
            return False
        places = set()
        for entry in self._evaluator.node(selector).entries.values():
            with self._evaluator.selecting(selector, entry.integer("Value", 0)):
                target = self._evaluator.target(name)
                if self._evaluator.kind(target) in REGISTERS:
                    places.add(self._evaluator.field(target))
        return len(places) == 1

    def _change_banks(self, selected: dict[str, float]) -> None:
        """Swap the values behind the selectors that were written."""
        for selector, names in self._banked.items():
            old, new = int(selected[selector]), int(self._evaluator.value(selector))
            for name in names if old != new else ():
                field = self._evaluator.field(self._evaluator.target(name))
                self._banks[name, old] = self._evaluator.bytes_of(field)
                self._evaluator.write(field, self._banks.get((name, new), bytes(field.length)))

    def _find_commands(self) -> list[tuple[Field, int, str]]:
        """The register of each command, the number that triggers it, and its name."""
        found = []
        for name in (*LIVE_COMMANDS, *(LATCHES if self._device.features.has_ptp else ())):
            if self._evaluator.kind(name) != "Command":
                continue
            frame = frame_trigger(self._evaluator)
            with contextlib.suppress(NodeError), self._evaluator.selecting_entry("TriggerSelector", frame):
                node = self._evaluator.node(name)
                number = node.integer("CommandValue", 1)
                if "pCommandValue" in node.parts:
                    number = int(self._evaluator.value(node.text("pCommandValue")))
                found.append((self._evaluator.field(self._evaluator.target(name)), number, name))
        return found

    def _run_commands(self, address: int, count: int) -> None:
        written = [
            (field, name)
            for field, number, name in self._commands
            if field.address < address + count
            and address < field.address + field.length
            and field.decode(self._evaluator.bytes_of(field)) == number
        ]
        for field, name in written:
            self._device.execute("PtpDataSetLatch" if name in LATCHES else name)
            self._evaluator.write(field, field.encode(0, self._evaluator.bytes_of(field)))  # reads 0: done
            if name in LATCHES:
                show_data_set(self._evaluator, self._device.features)
            if name == "TimestampLatch":
                self._latched_ns = int(self._device.features.get("TimestampLatchValue"))

    def _show_latch(self) -> None:
        """Write the latched time into its registers, on the first read, so that latching itself takes no time."""
        if self._latched_ns is not None:
            latched_ns, self._latched_ns = self._latched_ns, None
            with contextlib.suppress(NodeError):
                assign(self._evaluator, "TimestampLatchValue", latched_ns)

    def _show_payload(self) -> None:
        """Update the payload size, where it is in a register."""
        payload_bytes = self.payload_bytes
        with contextlib.suppress(NodeError):
            self._evaluator.set("PayloadSize", payload_bytes)

    def _chunk_port(self, entry: str) -> tuple[str, int]:
        """The port that a chunk is read through, and its id."""
        for field in self._evaluator.fields(f"Chunk{entry}").values():
            if field.port in self.chunk_ports:
                return field.port, int(self.description.nodes[field.port].text("ChunkID"), 16)
        raise NodeError(f"Chunk{entry} is not read through the port of a chunk")

    def _chunk_size(self, port: str) -> int:
        """Bytes of a chunk, up to the end of the last register read through its port."""
        nodes = [node for node in self.description.nodes.values() if node.text("pPort") == port]
        return max(node.integer("Address", 0) + node.integer("Length", 4) for node in nodes)

    def _chunk_bytes(self) -> int:
        """What the chunk data add to the payload: a tag follows the image and each chunk."""
        if not self._animation.chunk_mode:
            return 0
        sizes = [self._chunk_size(self._chunk_port(entry)[0]) for entry in self._animation.enabled_chunks]
        return sum(sizes) + CHUNK_TRAILER_BYTES * (1 + len(sizes))
