"""The camera over USB/IP, with a client of our own; and servers that lie, in a process under the shim."""

from __future__ import annotations

import hashlib
import io
import socket
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder
from fake_camera.device.features import Features
from fake_camera.device.unix_socket import listen
from fake_camera.genicam.registers import slots
from fake_camera.usb3.stream_channel import MEMORY_BYTES
from tests.fake_camera.gige.gige_client import ramp
from tests.fake_camera.usb3.usb3_client import (
    ACCESS_DENIED,
    CONTROL,
    EBUSY,
    ECONNRESET,
    ENOENT,
    EPIPE,
    EVENT,
    IN,
    INVALID_ADDRESS,
    INVALID_PARAMETER,
    MANIFEST_ADDRESS,
    NOT_IMPLEMENTED,
    OUT,
    READMEM,
    SBRM_ADDRESS,
    SIZES_INCONSISTENT,
    STREAM,
    STREAM_HALTED,
    SUCCESS,
    WRITE_PROTECT,
    UsbIpClient,
    connected,
    hung_up,
    receive,
    usb3_camera,
)
from tests.fakes import run_under_shim
from tests.meanwhile import wait_until

pytestmark = pytest.mark.wire

SLOTS = slots(Features("TEST", 720, 540, lambda: 0))
FRAME_BYTES = 720 * 540
GENICAM = "{http://www.genicam.org/GenApi/Version_1_1}"
TO_ENDPOINT, CLEAR_FEATURE, SET_FEATURE, GET_DESCRIPTOR = 0x02, 1, 3, 6
STREAM_IN = 0x80 | STREAM


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "camera"


@pytest.fixture
def camera(path: Path) -> Iterator[Device]:
    with usb3_camera(path) as camera:
        yield camera


@pytest.fixture
def host(camera: Device, path: Path) -> Iterator[UsbIpClient]:
    with UsbIpClient(path) as client:
        yield client


def test_the_camera_is_listed(camera: Device, path: Path) -> None:
    with connected(path) as stream:
        stream.sendall(struct.pack(">HHI", 0x0111, 0x8005, 0))
        answer = receive(stream, 12 + 312 + 3 * 4)
        assert struct.unpack_from(">HHII", answer) == (0x0111, 0x0005, 0, 1)
        assert answer[12 + 256 : 12 + 256 + 4] == b"1-1\0"
        assert answer[-12:] == bytes([0xEF, 5, 0, 0, 0xEF, 5, 1, 0, 0xEF, 5, 2, 0])
        with pytest.raises(EOFError):
            receive(stream, 1)


@pytest.mark.parametrize(
    "nonsense", [b"GET / HTTP/1.1\r\n\r\n", bytes(100), b"\xff" * 100], ids=["http", "zeros", "ones"]
)
def test_nonsense_ends_the_connection_and_disturbs_no_one(host: UsbIpClient, path: Path, nonsense: bytes) -> None:
    with connected(path) as stream:
        stream.sendall(nonsense)
        assert hung_up(stream)
    with UsbIpClient(path) as other:
        other.socket.sendall(nonsense[:48].ljust(48, b"\xff"))
        assert hung_up(other.socket)
    assert host.read_number(SBRM_ADDRESS, 8) > 0


@pytest.mark.parametrize(
    ("setup", "expected"),
    [
        ((0x80, 0, 0, 0, 2), (0, b"\1\0")),  # status of the device: self-powered
        ((0x80, 8, 0, 0, 1), (0, b"\0")),  # not configured yet
        ((0x00, 9, 1, 0, 0), (0, b"")),  # SET_CONFIGURATION
        ((0x00, 9, 7, 0, 0), (EPIPE, b"")),  # there is but one
        ((0x81, 10, 0, 2, 1), (0, b"\0")),  # the setting of an interface
        ((0x01, 11, 1, 2, 0), (EPIPE, b"")),  # there is no other
        ((0x80, GET_DESCRIPTOR, 0x0600, 0, 10), (EPIPE, b"")),  # device qualifier: not of SuperSpeed
        ((0xC0, 1, 0, 0, 10), (EPIPE, b"")),  # a vendor's own request
    ],
)
def test_requests_to_the_default_endpoint(
    host: UsbIpClient, setup: tuple[int, int, int, int, int], expected: tuple[int, bytes]
) -> None:
    assert host.request(*setup) == expected


def test_transfers_are_cut_to_what_was_asked_for_taken_back_or_refused(host: UsbIpClient) -> None:
    _, whole = host.request(0x80, GET_DESCRIPTOR, 0x0200, 0, 1024)
    assert struct.unpack_from("<H", whole, 2) == (len(whole),)
    assert host.request(0x80, GET_DESCRIPTOR, 0x0200, 0, 9) == (0, whole[:9])
    waiting = host.submit(STREAM, IN, 1024)
    assert (host.unlink(waiting), host.unlink(waiting)) == (ECONNRESET, 0)
    assert host.read(9, 1024) == (ENOENT, b"")  # there is no such endpoint


def test_a_client_finds_the_description_by_the_manifest(camera: Device, host: UsbIpClient) -> None:
    manifest = host.read_number(MANIFEST_ADDRESS, 8)
    assert host.read_number(manifest, 8) == 1
    entry = host.read_memory(manifest + 8, 64)
    file_format, address, length = struct.unpack_from("<IQQ", entry, 4)
    assert file_format >> 10 & 0x3F == 1  # zipped
    archive = host.read_memory(address, length)
    assert hashlib.sha1(archive).digest() == entry[24:44]
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        description = opened.read(opened.namelist()[0])
    root = ElementTree.fromstring(description)
    assert (root.get("StandardNameSpace"), root.get("ModelName")) == ("USB", "FakeU3V287M")
    assert {node.text for node in root.iter(f"{GENICAM}Endianess")} == {"LittleEndian"}
    assert not [node.get("Name") for node in root if str(node.get("Name")).startswith("Gev")]


def test_what_the_camera_cannot_do_is_answered_with_the_reason(host: UsbIpClient) -> None:
    assert host.command(READMEM, struct.pack("<QHH", 0xDEAD0000, 0, 4))[0] == INVALID_ADDRESS
    assert host.command(READMEM, struct.pack("<QHH", 0, 0, 2000))[0] == INVALID_PARAMETER
    assert host.command(0x0806, b"")[0] == NOT_IMPLEMENTED
    assert host.write_memory(0x0004, bytes(64)) == WRITE_PROTECT
    assert host.write_memory(SLOTS["Gain"], struct.pack("<d", 3.0)) == ACCESS_DENIED  # GainAuto holds it
    assert host.write_memory(SLOTS["PixelFormat"], struct.pack("<I", 1)) == INVALID_PARAMETER


def start(host: UsbIpClient, **sizes: int) -> None:
    assert host.start_stream(**sizes) == SUCCESS
    assert host.write_memory(SLOTS["AcquisitionStart"], struct.pack("<I", 1)) == SUCCESS


@pytest.mark.parametrize("transfer_bytes", [1 << 20, 100 * 1024])
def test_a_frame_comes_in_transfers_of_the_sizes_that_the_host_chose(host: UsbIpClient, transfer_bytes: int) -> None:
    start(host, transfer_bytes=transfer_bytes)
    for block in range(3):
        leader = host.read(STREAM, 1024)[1]
        assert (leader[:4], int.from_bytes(leader[8:16], "little")) == (b"U3VL", block)
        payload = b""
        while len(payload) < FRAME_BYTES:
            payload += host.read(STREAM, transfer_bytes)[1]
        assert np.array_equal(np.frombuffer(payload, np.uint8).reshape(540, 720), ramp(720, 540))
        trailer = host.read(STREAM, 1024)[1]
        assert trailer[:4] == b"U3VT"
        assert struct.unpack_from("<HHQ", trailer, 16) == (0, 0, FRAME_BYTES)


def test_what_does_not_fit_the_hosts_transfers_is_discarded_and_told(host: UsbIpClient) -> None:
    assert host.start_stream() == SUCCESS
    sirm = host.stream_registers()
    assert host.write_memory(sirm + 0x04, bytes(4)) == SUCCESS
    assert host.write_memory(sirm + 0x20, b"\xff" * 4) == SUCCESS  # ever so many transfers ...
    assert host.write_memory(sirm + 0x1C, bytes(4)) == SUCCESS  # ... of nothing
    assert host.write_memory(sirm + 0x24, struct.pack("<I", 4096)) == SUCCESS
    assert host.write_memory(sirm + 0x04, struct.pack("<I", 1)) == SUCCESS
    assert host.write_memory(SLOTS["AcquisitionStart"], struct.pack("<I", 1)) == SUCCESS
    leader, payload, trailer = (host.read(STREAM, 1 << 20)[1] for _ in range(3))
    assert (leader[:4], len(payload), trailer[:4]) == (b"U3VL", 4096, b"U3VT")
    assert struct.unpack_from("<HHQ", trailer, 16) == (0xA100, 0, 4096)


def test_sizes_are_fixed_while_the_stream_is_on_and_must_fit(host: UsbIpClient) -> None:
    sirm = host.stream_registers()
    assert host.write_memory(sirm + 0x04, struct.pack("<I", 1)) == SIZES_INCONSISTENT
    assert host.start_stream() == SUCCESS
    assert host.write_memory(sirm + 0x18, struct.pack("<I", 2048)) == ACCESS_DENIED


def test_frames_that_nobody_fetches_fill_the_memory_and_are_discarded(camera: Device, host: UsbIpClient) -> None:
    camera.features.update("AcquisitionFrameRate", 300.0)
    camera.features.update("ExposureTime", 100.0)
    start(host)
    wait_until(lambda: camera.counters.discarded > 3)
    assert host.write_memory(SLOTS["AcquisitionStop"], struct.pack("<I", 1)) == SUCCESS
    blocks = []
    for _frame in range(MEMORY_BYTES // FRAME_BYTES):
        blocks.append(int.from_bytes(host.read(STREAM, 1024)[1][8:16], "little"))
        host.read(STREAM, 1 << 20)
        host.read(STREAM, 1024)
    assert blocks[0] == 0
    assert blocks == sorted(blocks)


def test_a_halted_stream_is_not_enabled_until_it_is_cleared(host: UsbIpClient) -> None:
    assert host.request(TO_ENDPOINT, SET_FEATURE, 0, STREAM_IN, 0) == (0, b"")
    assert host.request(0x82, 0, 0, STREAM_IN, 2) == (0, b"\1\0")
    assert host.read(STREAM, 1024) == (EPIPE, b"")
    assert host.start_stream() == STREAM_HALTED
    assert host.request(TO_ENDPOINT, CLEAR_FEATURE, 0, STREAM_IN, 0) == (0, b"")
    assert host.start_stream() == SUCCESS


def test_a_test_event_is_sent_to_who_wants_it(camera: Device, host: UsbIpClient) -> None:
    eirm = host.read_number(host.read_number(SBRM_ADDRESS, 8) + 0x2C, 8)
    for enabled in (0, 1):
        assert host.write_memory(eirm, struct.pack("<I", enabled)) == SUCCESS
        assert host.write_memory(eirm + 8, struct.pack("<I", 1)) == SUCCESS
    status, event = host.read(EVENT, 1024)
    assert (status, event[:4]) == (0, b"U3VE")
    assert struct.unpack_from("<HHHHHH", event, 4) == (0, 0x0C00, 12, 1, 0, 0x4FFF)
    assert struct.unpack_from("<Q", event, 16)[0] <= camera.now_ns()


def test_the_end_of_an_exposure_is_told_to_who_wants_it(camera: Device, host: UsbIpClient) -> None:
    """Time at 4 and frame id at 0xC, where the description of a FLIR Blackfly S has them."""
    eirm = host.read_number(host.read_number(SBRM_ADDRESS, 8) + 0x2C, 8)
    assert host.write_memory(eirm, struct.pack("<I", 1)) == SUCCESS
    camera.features.set("ExposureAuto", "Off")
    camera.features.set("ExposureTime", 2000.0)
    assert host.write_memory(SLOTS["EventNotification"], struct.pack("<I", 1)) == SUCCESS
    start(host)
    status, event = host.read(EVENT, 1024)
    leader = host.read(STREAM, 1024)[1]
    assert (status, event[:4]) == (0, b"U3VE")
    assert struct.unpack_from("<HHHH", event, 4) == (0, 0x0C00, 20, 1)
    item = event[12:]
    assert struct.unpack_from("<HH", item) == (0, 0x9001)
    assert item[0xC:0x14] == leader[8:16]
    began_ns, ended_ns = (int.from_bytes(data, "little") for data in (leader[20:28], item[4:0xC]))
    assert ended_ns - began_ns == 2_000_000


def test_an_interface_is_one_clients_until_it_lets_go(host: UsbIpClient, path: Path) -> None:
    with UsbIpClient(path) as other:
        assert host.claim(0) == host.claim(0) == host.claim(2) == 0
        assert other.claim(0) == EBUSY
        assert other.claim(9) == ENOENT
        assert other.read(STREAM, 1024) == (EBUSY, b"")  # to use it is to claim it
        assert other.request(0x80, GET_DESCRIPTOR, 0x0100, 0, 18)[0] == 0
        assert host.claim(0, claims=False) == 0
        assert other.claim(0) == 0
        host.socket.close()
        wait_until(lambda: other.claim(2) == 0)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def test_over_tcp_a_host_takes_the_camera_for_itself(path: Path) -> None:
    port = free_port()
    with usb3_camera(path, tcp_port=port), UsbIpClient(port) as host:
        assert host.import_status == 0
        assert host.read_number(SBRM_ADDRESS, 8) > 0
        with UsbIpClient(port) as second, UsbIpClient(path) as local:
            assert second.import_status == 1
            assert local.claim(0) == EBUSY
        host.socket.sendall(struct.pack(">IIIII28x", 0x0AE1, 99, 0, 1, 0))  # no word of USB/IP
        assert hung_up(host.socket)


def test_a_vanished_camera_hangs_up_and_comes_back_in_power_on_state(camera: Device, path: Path) -> None:
    with UsbIpClient(path) as host:
        camera.features.set("ExposureAuto", "Off")
        assert host.start_stream() == SUCCESS
        camera.faults.add(FaultOrder(Fault.VANISH, None, None))
        assert hung_up(host.socket)
        assert not path.exists()
    camera.faults.add(FaultOrder(Fault.COME_BACK))
    with UsbIpClient(path) as host:
        assert host.read_number(host.stream_registers() + 0x04, 4) == 0
        assert host.claim(0) == host.claim(2) == 0
    assert camera.features.get("ExposureAuto") == "Continuous"


def test_a_camera_whose_path_was_taken_stays_unplugged_and_says_so(
    camera: Device, path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    camera.faults.add(FaultOrder(Fault.VANISH, None, None))
    with listen(path, "other socket"):
        camera.faults.add(FaultOrder(Fault.COME_BACK))
        assert capfd.readouterr().err == (
            f"the camera stays unplugged: the socket {path} cannot be opened: Address already in use\n"
        )
        pulses = camera.counters.pulses
        wait_until(lambda: camera.counters.pulses > pulses)
        assert path.is_socket()  # the other one's


def test_a_command_that_is_not_taken_waits_until_the_host_gives_up(camera: Device, host: UsbIpClient) -> None:
    camera.faults.add(FaultOrder(Fault.NAK))
    packet = b"U3VC" + struct.pack("<HHHHQHH", 0x4000, READMEM, 12, 1, 0, 0, 4)
    assert host.unlink(host.submit(CONTROL, OUT, len(packet), packet)) == ECONNRESET
    assert host.read_number(0x0000, 4) == 0x00010001


def test_a_pending_acknowledge_comes_before_the_answer(camera: Device, host: UsbIpClient) -> None:
    camera.faults.add(FaultOrder(Fault.PENDING_ACKNOWLEDGE))
    packet = b"U3VC" + struct.pack("<HHHHQHH", 0x4000, READMEM, 12, 0, 0, 0, 4)
    assert host.write(CONTROL, packet) == 0
    status, payload = host.acknowledgement(0x0805)
    assert (status, len(payload)) == (SUCCESS, 4)
    assert host.acknowledgement(0x0801) == (SUCCESS, struct.pack("<I", 0x00010001))


@pytest.mark.parametrize(
    ("fault", "payload_bytes", "trailer_bytes"),
    [(Fault.TRUNCATE, FRAME_BYTES // 2, 32), (Fault.SHORT_TRAILER, FRAME_BYTES, 8)],
)
def test_a_spoilt_frame(
    camera: Device, host: UsbIpClient, fault: Fault, payload_bytes: int, trailer_bytes: int
) -> None:
    camera.faults.add(FaultOrder(fault))
    start(host)
    sizes = [len(host.read(STREAM, length)[1]) for length in (1024, 1 << 20, 1024) * 2]
    assert sizes == [52, payload_bytes, trailer_bytes, 52, FRAME_BYTES, 32]


def test_a_stall_takes_the_place_of_a_frame(camera: Device, host: UsbIpClient) -> None:
    camera.faults.add(FaultOrder(Fault.STALL))
    start(host)
    assert host.read(STREAM, 1024) == (EPIPE, b"")
    assert host.request(TO_ENDPOINT, CLEAR_FEATURE, 0, STREAM_IN, 0) == (0, b"")
    assert host.read(STREAM, 1024)[1][:4] == b"U3VL"


def test_hostile_cameras_under_the_shim(tmp_path: Path) -> None:
    """Cameras that stop and servers that lie; most of its time is spent waiting."""
    run_under_shim(Path(__file__).with_name("hostile_suite.py"), tmp_path / "left", tmp_path / "right")
