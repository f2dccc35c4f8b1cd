from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from itertools import pairwise
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder, Faults
from fake_camera.device.feature_table import CHUNK_BYTES, ENUM_ENTRIES, Spec
from fake_camera.device.features import FeatureError, Features
from fake_camera.genicam.chunks import CHUNKS
from fake_camera.genicam.description import genicam_xml, zipped
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.registers import (
    COMMANDS,
    PTP_COMMANDS,
    ByteOrder,
    Register,
    RegisterMap,
    decode,
    encode,
    feature_registers,
    slots,
)
from fake_camera.genicam.status import CommandError, Status
from fake_camera.gige.actions import ActionChannel
from fake_camera.gige.bootstrap import GIGE_VISION, bootstrap_registers, mac_address
from fake_camera.gige.message_channel import MessageChannel
from fake_camera.gige.stream_channel import StreamChannel
from fake_camera.usb3 import bootstrap as usb3_bootstrap
from fake_camera.usb3.event_channel import EventChannel
from fake_camera.usb3.stream_channel import StreamChannel as Usb3Stream
from fake_camera.usb3.usb.endpoint import InEndpoint
from tests.fake_camera.gige.gige_client import device

PTP_CLOCK = 0x0200_00FF_FE00_0001
FEATURES = Features("TEST", 720, 540, lambda: 0, ptp_clock=PTP_CLOCK)
SPECS = [FEATURES.spec(name) for name in FEATURES.names]
SLOTS = slots(FEATURES)
DESCRIPTION = genicam_xml(FEATURES, GIGE_VISION)
GENICAM = "{http://www.genicam.org/GenApi/Version_1_1}"


@pytest.fixture
def camera() -> Iterator[Device]:
    with device(ptp_clock=PTP_CLOCK) as camera:
        yield camera


@pytest.fixture
def registers(camera: Device) -> Iterator[list[Register]]:
    stream, messages = StreamChannel("127.0.0.1", Faults()), MessageChannel("127.0.0.1")
    packed = zipped("FakeGV287M", DESCRIPTION)
    privilege = ControlPrivilege()
    actions = ActionChannel(camera, privilege)
    yield [
        *bootstrap_registers(camera, "127.0.0.9", privilege, stream, messages, description=packed, actions=actions),
        *feature_registers(camera, "big"),
    ]
    stream.close()
    messages.close()


@pytest.fixture
def memory(registers: list[Register]) -> RegisterMap:
    return RegisterMap(registers)


def values(spec: Spec) -> st.SearchStrategy[object]:
    match spec.type:
        case "integer":
            if spec.minimum < 0:
                return st.integers(-(2**63), 2**63 - 1)
            return st.integers(0, 2**64 - 1 if spec.unit == "ns" else 2**32 - 1)
        case "float":
            return st.floats(allow_nan=False)
        case "boolean":
            return st.booleans()
        case "string":
            return st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=64)
        case "enumeration":
            return st.sampled_from(sorted(ENUM_ENTRIES[spec.name]))


@given(st.data())
def test_values_survive_the_wire(data: st.DataObject) -> None:
    spec = data.draw(st.sampled_from(SPECS))
    value = data.draw(values(spec))
    byte_order: ByteOrder = data.draw(st.sampled_from(("big", "little")))
    assert decode(spec, encode(spec, value, byte_order), byte_order) == value  # type: ignore[arg-type]


@given(st.data())
def test_any_bytes_are_a_value_or_an_invalid_parameter(data: st.DataObject) -> None:
    spec = data.draw(st.sampled_from(SPECS))
    length = len(encode(spec, spec.initial, "big"))
    try:
        decode(spec, data.draw(st.binary(min_size=length, max_size=length)), "big")
    except CommandError as error:
        assert error.status == Status.INVALID_PARAMETER


@given(address=st.integers(0, 0x102000), count=st.integers(1, 600))
def test_every_read_gives_its_bytes_or_an_error(address: int, count: int) -> None:
    memory = RegisterMap([Register(0, 8, lambda: bytes(8)), Register(8, 0x400, lambda: bytes(0x400))])
    try:
        assert len(memory.read(address, count)) == count
    except CommandError as error:
        assert error.status in (Status.BAD_ALIGNMENT, Status.INVALID_ADDRESS)


def usb3_registers(camera: Device) -> list[Register]:
    stream, events = Usb3Stream(InEndpoint(), Faults(), camera.counters), EventChannel(InEndpoint(), lambda: 0)
    return [
        *usb3_bootstrap.bootstrap_registers(camera, stream, events, bytes(100), lambda: 0),
        *feature_registers(camera, "little"),
    ]


@pytest.mark.parametrize("transport", ["gige", "usb3"])
def test_registers_are_apart_and_the_description_declares_just_these(
    transport: str, camera: Device, registers: list[Register]
) -> None:
    description, unit = (
        (DESCRIPTION, 4) if transport == "gige" else (genicam_xml(FEATURES, usb3_bootstrap.USB3_VISION), 1)
    )
    ordered = registers if transport == "gige" else usb3_registers(camera)
    ordered = sorted(ordered, key=lambda register: register.address)
    assert all(register.address % unit == register.length % unit == 0 for register in ordered)
    assert all(one.address + one.length <= other.address for one, other in pairwise(ordered))
    assert all(len(register.read()) == register.length for register in ordered)
    by_address = {register.address: register for register in ordered}
    for kind in ("IntReg", "FloatReg", "StringReg", "MaskedIntReg"):
        for node in ElementTree.fromstring(description).iter(f"{GENICAM}{kind}"):
            if node.findtext(f"{GENICAM}pPort") == "Device":
                register = by_address[int(node.findtext(f"{GENICAM}Address", ""), 16)]
                assert register.length >= int(node.findtext(f"{GENICAM}Length", "")), node.get("Name")
                writable = node.findtext(f"{GENICAM}AccessMode") == "RW"
                assert (register.write is not None) == writable, node.get("Name")


def test_every_feature_is_in_just_one_category_and_every_reference_leads_somewhere() -> None:
    root = ElementTree.fromstring(DESCRIPTION)
    names = [node.get("Name") for node in root]
    assert len(names) == len(set(names))
    listed = [item.text for item in root.iter(f"{GENICAM}pFeature")]
    assert len(listed) == len(set(listed))
    assert set(listed) >= {*FEATURES.names, *COMMANDS, *PTP_COMMANDS, *(f"Chunk{name}" for name in CHUNKS)}
    references = {
        item.text for item in root.iter() if item.tag.removeprefix(GENICAM).startswith("p") and item.text is not None
    }
    assert references <= set(names)


def test_ptp_and_actions_are_in_their_registers(camera: Device, memory: RegisterMap) -> None:
    def register(address: int) -> int:
        return int.from_bytes(memory.read(address, 4), "big")

    assert register(0x0934) & 0x1E0040 == 0x1E0040  # capabilities
    assert (register(0x0908), register(0x0970)) == (1, 10)
    assert register(0x0954) == 0x40000
    assert register(0x096C) == 3  # disabled
    memory.write(0x0954, (0x80000 | 8).to_bytes(4, "big"))
    assert camera.features.get("PtpEnable") is True
    assert camera.features.get("ActionUnconditionalMode") == "On"
    assert register(0x0954) == 0x80008
    assert register(0x096C) == 1  # initializing
    for address, name in ((0x090C, "ActionDeviceKey"), (0x9800, "ActionGroupKey"), (0x9804, "ActionGroupMask")):
        memory.write(address, b"\xca\xfe\0\1")
        assert camera.features.get(name) == 0xCAFE0001
        assert register(address) == (0 if name == "ActionDeviceKey" else 0xCAFE0001)


def test_a_camera_without_ptp_has_none_of_it() -> None:
    plain = Features("TEST", 720, 540, lambda: 0)
    assert not [name for name in slots(plain) if name.startswith(("Ptp", "ActionD", "ActionG"))]
    description = genicam_xml(plain, GIGE_VISION)
    assert b"PtpControl" not in description
    assert b"Action1" not in description
    assert b"Action1" in DESCRIPTION
    with pytest.raises(FeatureError, match="no entry"):
        plain.set("TriggerSource", "Action1")


def test_bootstrap_registers_say_who_it_is_and_keep_what_they_can(memory: RegisterMap) -> None:
    assert memory.read(0x0024, 4) == bytes([127, 0, 0, 9])
    assert memory.read(0x00D8, 16) == b"TEST".ljust(16, b"\0")
    assert memory.read(0x0008, 8)[:3] == b"\0\0\x02"
    assert mac_address("LEFT") != mac_address("RIGHT")
    memory.write(0x0D00, b"\0\1\xd4\x31")
    assert memory.read(0x0D00, 4) == b"\0\0\xd4\x31"  # a port and no interface
    memory.write(0x00E8, b"bow".ljust(16, b"\0"))
    assert memory.read(SLOTS["DeviceUserID"], 64).rstrip(b"\0") == b"bow"
    foreign_clock = encode(FEATURES.spec("PtpGrandmasterClockID"), 0xFEDC_BA98_7654_3210, "big")
    assert foreign_clock == bytes.fromhex("fedcba9876543210")
    assert dict.fromkeys(CHUNKS, 8) == CHUNK_BYTES


@pytest.mark.parametrize(("address", "value"), [(0x0D04, 100), (0x0D08, 1_000_001), (0x0938, 499), (0x0944, 1)])
def test_a_bootstrap_register_refuses_what_it_cannot_be(memory: RegisterMap, address: int, value: int) -> None:
    before = memory.read(address, 4)
    with pytest.raises(CommandError) as error:
        memory.write(address, struct.pack(">I", value))
    assert error.value.status == Status.INVALID_PARAMETER
    assert memory.read(address, 4) == before


@pytest.mark.parametrize(
    ("name", "data", "status"),
    [
        ("ExposureTime", struct.pack(">d", 5.0), Status.INVALID_PARAMETER),
        ("ExposureTime", struct.pack(">d", math.nan), Status.INVALID_PARAMETER),
        ("ExposureTime", struct.pack(">f", 5000.0), Status.BAD_ALIGNMENT),
        ("Gain", struct.pack(">d", 3.0), Status.ACCESS_DENIED),
        ("Width", struct.pack(">I", 4), Status.INVALID_PARAMETER),
        ("PixelFormat", struct.pack(">I", 0x02180020), Status.INVALID_PARAMETER),
        ("DeviceUserID", b"\xff".ljust(64, b"\0"), Status.INVALID_PARAMETER),
        ("SensorWidth", struct.pack(">I", 640), Status.WRITE_PROTECT),
    ],
)
def test_a_write_that_the_camera_refuses(
    camera: Device, memory: RegisterMap, name: str, data: bytes, status: Status
) -> None:
    camera.features.set("ExposureAuto", "Off")
    before = camera.features.get(name)
    with pytest.raises(CommandError) as error:
        memory.write(SLOTS[name], data)
    assert error.value.status == status
    assert camera.features.get(name) == before


@pytest.mark.parametrize("latch", [0x0944, SLOTS["TimestampLatch"]])
def test_timestamp_latch_in_both_dialects(camera: Device, memory: RegisterMap, latch: int) -> None:
    before = camera.now_ns()
    memory.write(latch, struct.pack(">I", 2))
    latched = int.from_bytes(memory.read(0x0948, 8), "big")
    assert before <= latched <= camera.now_ns()
    assert memory.read(SLOTS["TimestampLatchValue"], 8) == memory.read(0x0948, 8)
    assert memory.read(0x093C, 8) == struct.pack(">Q", 1_000_000_000)


def test_nodes_that_refuse_stick_or_shrink_as_ordered(camera: Device, memory: RegisterMap) -> None:
    camera.faults.add(FaultOrder(Fault.REFUSE_WRITES, None, 2))
    for name in ("ExposureAuto", "AcquisitionStart"):
        with pytest.raises(CommandError) as error:
            memory.write(SLOTS[name], struct.pack(">I", 0))
        assert error.value.status == Status.ACCESS_DENIED
    for feature in ("ExposureAuto", "GainAuto"):
        camera.features.set(feature, "Off")
    spec, address = camera.features.spec("ExposureTime"), SLOTS["ExposureTime"]
    taken = []
    for fault in (Fault.STICK, Fault.SHRINK, None):
        if fault is not None:
            camera.faults.add(FaultOrder(fault))
        memory.write(address, encode(spec, 1000.0, "big"))
        taken.append(decode(spec, memory.read(address, 8), "big"))
    assert taken == [5000.0, 950.0, 1000.0]
