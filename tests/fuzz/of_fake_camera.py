"""What the fake camera reads from outside: commands, transfers, orders and files; without threads or frames."""

from __future__ import annotations

import fcntl
import io
import json
import socket
import struct
from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from typing import Any

import cv2
import numpy as np

from fake_camera.device.acquisition import Counters
from fake_camera.device.control_socket import answers
from fake_camera.device.faults import Fault, FaultOrder, Faults
from fake_camera.device.features import Features
from fake_camera.device.line0 import Line0
from fake_camera.genapi.description import Description
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genapi.xml_registers import XmlRegisters
from fake_camera.genicam.description import genicam_xml, zipped
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.registers import RegisterMap, feature_registers, slots
from fake_camera.genicam.status import CommandError, Status
from fake_camera.gige.bootstrap import CONTROL_PRIVILEGE, GIGE_VISION, bootstrap_registers
from fake_camera.gige.control_channel import ControlChannel
from fake_camera.gige.gvcp import Action, Command
from fake_camera.gige.message_channel import MessageChannel
from fake_camera.gige.stream_channel import StreamChannel
from fake_camera.ptp.clock import Clock
from fake_camera.ptp.master import Master
from fake_camera.ptp.messages import Grandmaster, Message, MessageType, PortIdentity
from fake_camera.ptp.slave import Slave
from fake_camera.usb3 import u3vcp
from fake_camera.usb3.usb.descriptors import CONTROL_IN, CONTROL_OUT, STREAM_IN
from fake_camera.usb3.usb_device import UsbDevice
from fake_camera.usb3.usbip import messages
from fake_camera.usb3.usbip.connection import Claims, Connection
from fake_camera.world.lighting import LightScript
from fake_camera.world.scene.panorama import load_radiance
from fake_camera.world.steered import Motion, Steered
from tests.fake_camera.gige.gige_client import command
from tests.fuzz.target import framed, in_file, unframed
from tests.xml_cameras import COMBINATIONS, xml_camera

PEERS = ("10.0.0.1", 5000), ("10.0.0.2", 5000)
PTP_EPOCH_NS = 1_700_000_000_000_000_000
WIRE = "wire"
ATTACH = messages.OPERATION.pack(0x0111, messages.REQUEST_IMPORT, 0) + messages.BUS_ID.encode().ljust(32, b"\0")


class StillDevice:
    """The part of a device that registers speak to; it takes no images."""

    def __init__(self, model: str = "FakeGV287M") -> None:
        self.features = Features("FUZZ", 720, 540, self.now_ns, model=model)
        self.faults = Faults()
        self.counters = Counters()

    def now_ns(self) -> int:
        return 1_000_000_000

    def execute(self, name: str) -> None:
        if name == "TimestampLatch":
            self.features.update("TimestampLatchValue", self.now_ns())
        elif name == "DeviceReset":
            self.features.reset()

    def connect(self, sink: object, exposure_ended: object) -> None:
        pass

    def on_power_on(self, callback: object) -> None:
        pass


@cache
def _gige_description() -> bytes:
    return zipped("FUZZ", genicam_xml(StillDevice().features, GIGE_VISION))


class GigeCamera:
    """A control channel over all the registers there are."""

    def __init__(self) -> None:
        device: Any = StillDevice()
        device.faults.add(FaultOrder(Fault.VANISH, count=None))  # no stream packet leaves the camera
        self._features = device.features
        self._stream = StreamChannel("127.0.0.1", device.faults)
        privilege = ControlPrivilege()
        messages = MessageChannel("127.0.0.1")
        bootstrap = bootstrap_registers(
            device, "127.0.0.1", privilege, self._stream, messages, description=_gige_description()
        )
        registers = RegisterMap((*bootstrap, *feature_registers(device, "big")))
        self.channel = ControlChannel(registers, privilege, self._stream.resend, self._stream.stop, self._act)

    def _act(self, action: Action) -> Status | None:
        return Status.SUCCESS if action.time_ns else None

    def power_on(self) -> None:
        self._features.reset()
        self.channel.reset()
        self._stream.reset()


@cache
def _gige_camera() -> GigeCamera:
    return GigeCamera()


def gvcp_commands(data: bytes) -> None:
    """Datagrams of two clients by turns."""
    camera = _gige_camera()
    camera.power_on()
    for number, datagram in enumerate(unframed(data)):
        camera.channel.answer(datagram, PEERS[number % 8 == 7], 100.0 + number)


def gvcp_answer() -> bytes:
    """What the camera answers to a search."""
    answer = _gige_camera().channel.answer(command(Command.DISCOVERY, b"", 1), PEERS[0], 0.0)
    assert answer is not None
    return answer


def gvcp_seeds() -> Iterator[bytes]:
    take = command(Command.WRITEREG, struct.pack(">II", CONTROL_PRIVILEGE, 2), 1)
    addresses = slots(StillDevice().features)
    time_us = command(Command.WRITEMEM, struct.pack(">Id", addresses["ExposureTime"], 1500.0), 2)
    user = command(Command.WRITEMEM, struct.pack(">I64s", addresses["DeviceUserID"], b"robot"), 3)
    start = command(Command.WRITEREG, struct.pack(">II", addresses["AcquisitionStart"], 1), 4)
    size = command(Command.WRITEREG, struct.pack(">IIII", 0x0D04, 1 << 31 | 1500, 0x0D00, 4000), 5)
    read = command(Command.READREG, struct.pack(">II", CONTROL_PRIVILEGE, addresses["Width"]), 6)
    memory = command(Command.READMEM, struct.pack(">IHH", 0x200, 0, 512), 7)
    again = command(Command.PACKETRESEND, struct.pack(">HHII", 0, 1, 1, 0xFFFFFF), 8)
    action = command(Command.ACTION, struct.pack(">IIIQ", 1, 2, 3, 4), 9, flags=0x81)
    yield framed(take, time_us, user, start, size, read, memory, again, action)
    yield framed(command(Command.DISCOVERY, b"", 1), command(Command.FORCEIP, bytes(56), 2), command(0x1234, b"", 3))


def ptp_messages(data: bytes) -> None:
    """Datagrams to a master and a slave, an eighth of a second apart."""
    clock = Clock(0)
    stations = (
        Slave(clock, PortIdentity(1), lambda: True),
        Master(PortIdentity(2), lambda host_ns: PTP_EPOCH_NS + host_ns),
    )
    for number, datagram in enumerate(unframed(data)):
        now_ns = number * 125_000_000
        message = Message.from_bytes(datagram)
        for station in stations:
            if message is not None:
                station.receive(message, now_ns)
            for answer in station.poll(now_ns):
                assert Message.from_bytes(answer.to_bytes()) == answer
                station.sent(answer, now_ns)
    clock.time_ns(clock.host_ns(0))


def ptp_seeds() -> Iterator[bytes]:
    master = PortIdentity(2)
    announce = Message(MessageType.ANNOUNCE, master, 0, grandmaster=Grandmaster(2)).to_bytes()
    exchange = [
        Message(MessageType.SYNC, master, 1, two_step=True).to_bytes(),
        Message(MessageType.FOLLOW_UP, master, 1, PTP_EPOCH_NS).to_bytes(),
        Message(MessageType.DELAY_RESP, master, 1, PTP_EPOCH_NS, requester=PortIdentity(1)).to_bytes(),
    ]
    yield framed(announce, announce, *exchange)
    yield framed(Message(MessageType.DELAY_REQ, PortIdentity(3), 7).to_bytes())


class Wire:
    """A stream socket on which `received` arrives before the client hangs up; what is sent goes nowhere."""

    family = socket.AF_UNIX

    def __init__(self, received: bytes) -> None:
        self._received = received

    def __enter__(self) -> Wire:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def recv(self, count: int) -> bytes:
        part, self._received = self._received[:count], self._received[count:]
        return part

    def sendmsg(self, buffers: list[bytes | memoryview]) -> int:
        return sum(len(buffer) for buffer in buffers)

    def sendall(self, data: bytes | memoryview) -> None:
        assert not data


@cache
def _usb3_camera() -> tuple[StillDevice, UsbDevice]:
    device: Any = StillDevice("FakeU3V287M")
    return device, UsbDevice(device)


def usb3_connection(data: bytes) -> None:
    """All that a USB/IP client sends, U3VCP commands to all the registers there are among it."""
    device, usb = _usb3_camera()
    device.features.reset()
    usb.reset()
    Connection(Wire(data), usb, Claims(usb.released)).serve()  # type: ignore[arg-type]


def submit(sequence: int, endpoint: int, length: int, data: bytes = b"", setup: bytes = bytes(8)) -> bytes:
    head = struct.pack(">IIIII", 1, sequence, 0, endpoint >> 7, endpoint & 15)
    return head + struct.pack(">IIIII", 0, length, 0, 0xFFFFFFFF, 0) + setup + data


def usb3_seeds() -> Iterator[bytes]:
    addresses = slots(StillDevice().features)
    words = [
        struct.pack("<4sHHHHQHH", b"U3VC", 1 << 14, u3vcp.Command.READMEM, 12, 1, 0x1D8, 0, 8),
        struct.pack("<4sHHHHQd", b"U3VC", 1 << 14, u3vcp.Command.WRITEMEM, 16, 2, addresses["ExposureTime"], 1500.0),
    ]
    reads = b"".join(submit(number, CONTROL_IN, 1024) for number in range(1, 3))
    writes = b"".join(submit(number, CONTROL_OUT, len(word), word) for number, word in enumerate(words, 3))
    setups = (
        (0x80, 6, 0x0100, 0, 18),
        (0x80, 6, 0x0303, 0, 255),
        (0x02, 3, 0, STREAM_IN, 0),
        (0x02, 1, 0, STREAM_IN, 0),
    )
    requests = b"".join(
        submit(number, setup[0] & 0x80, setup[4], setup=struct.pack("<BBHHH", *setup))
        for number, setup in enumerate(setups, 10)
    )
    unlink = struct.pack(">IIIIII24x", 2, 20, 0, 0, 0, 21)
    claim = struct.pack(">IIIII28x", 0x0AE1, 22, 0, 1, 0)
    yield ATTACH + claim + reads + writes + requests + submit(21, STREAM_IN, 4096) + unlink
    yield messages.OPERATION.pack(0x0111, messages.REQUEST_DEVICE_LIST, 0)


def fault_orders(data: bytes) -> None:
    faults = Faults()
    for line in data.splitlines():
        faults.add(FaultOrder.from_json(line.decode(errors="replace")))
    faults.on_trigger(1)


def control_socket(data: bytes) -> None:
    """Lines of any length: each is answered by one, and none by more than a screen of words."""
    faults = Faults()
    said = [json.loads(answer) for answer in answers(io.BytesIO(data), faults, Steered())]
    assert len(said) == len(io.BytesIO(data).readlines())
    assert all(len(str(answer.get("error"))) < 1000 for answer in said)
    faults.on_trigger(1)


def fault_seeds() -> Iterator[bytes]:
    for name in sorted(Fault):
        yield json.dumps({"fault": name, "after_trigger": None}).encode()
    yield b'{"fault": "freeze", "count": 3, "after_trigger": 7}\n{"fault": "vanish", "count": null}'


def order_seeds() -> Iterator[bytes]:
    yield from fault_seeds()
    yield b'{"light": {"at_ns": 5, "lux": 2.5}}'
    yield json.dumps({"motion": dict.fromkeys([field.name for field in fields(Motion)], 1)}).encode()


def light_script(data: bytes) -> None:
    script = LightScript.from_file(in_file(data, "light.yaml"))
    script.mean_lux(5.0, 0.01)


def light_seeds() -> Iterator[bytes]:
    yield (
        b"repeat_s: 20\nflicker: {frequency_hz: 100, depth: 0.8}\n"
        b"light:\n  - {at_s: 0, lux: 150}\n  - {at_s: 4, lux: 1}\n  - {at_s: 8, lux: 50, ramp_s: 3}\n"
    )


def radiance(data: bytes) -> None:
    load_radiance(in_file(data, "scene.hdr"))


def radiance_seeds() -> Iterator[bytes]:
    yield cv2.imencode(".hdr", np.linspace(0, 9, 16 * 12 * 3, dtype=np.float32).reshape(12, 16, 3))[1].tobytes()


def wire_file(data: bytes) -> None:
    """The file by which processes share Line0, while another process holds it."""
    path = in_file(data, f"fake-camera-line0-{WIRE}")
    with path.open("rb") as other:
        fcntl.flock(other, fcntl.LOCK_SH)
        line0 = Line0.join(WIRE, 60.0, path.parent)
        line0.first_pulse_after(10**12)
        line0.close()


def wire_seeds() -> Iterator[bytes]:
    directory = in_file(b"", "new/none").parent
    line0 = Line0.join(WIRE, 60.0, directory)
    yield (directory / f"fake-camera-line0-{WIRE}").read_bytes()
    line0.close()


def description(data: bytes) -> None:
    """A description, and writes to the registers of the camera that wears it: address and data each."""
    text, *writes = unframed(data)
    device: Any = StillDevice()
    camera = XmlCamera(Description.from_bytes(text, "camera.xml"), device)
    registers = XmlRegisters((), camera)
    for write in writes:
        address = int.from_bytes(write[:4], "big")
        try:
            registers.read(address, 4)
            registers.write(address, write[4:])
        except CommandError:
            continue
    _ = camera.payload_bytes


def description_seeds() -> Iterator[bytes]:
    for number in range(len(COMBINATIONS)):
        writes = [struct.pack(">II", 0x20000 + 16 * place, 1) for place in range(24)]
        yield framed(xml_camera(number), *writes)
    indented = genicam_xml(StillDevice().features, GIGE_VISION)
    yield framed(b"".join(line.strip() for line in indented.splitlines()))  # what a frame has room for
