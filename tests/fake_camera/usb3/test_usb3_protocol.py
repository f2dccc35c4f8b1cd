"""The bytes of USB3 Vision and USB/IP, the descriptors, and what becomes of transfers."""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.features import Features
from fake_camera.genicam.status import CommandError, Status
from fake_camera.imaging import ExposedFrame
from fake_camera.usb3 import u3vcp, u3vsp
from fake_camera.usb3.u3vcp import Request
from fake_camera.usb3.usb import descriptors
from fake_camera.usb3.usb.descriptors import Identity
from fake_camera.usb3.usb.endpoint import InEndpoint, ReadRequest
from fake_camera.usb3.usbip import messages
from tests.fake_camera.gige.gige_client import ramp

SETTINGS = Features("TEST", 720, 540, lambda: 0).image_settings(0)
FRAME = ExposedFrame(7, 7, 123_456_789_012, ramp(720, 540), SETTINGS)


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF), st.booleans(), st.binary(max_size=100))
def test_a_command_is_read_and_acknowledged(command: int, request_id: int, ack: bool, payload: bytes) -> None:
    head = b"U3VC" + struct.pack("<HHHH", 0x4000 * ack, command, len(payload), request_id)
    request = Request.from_bytes(head + payload)
    assert request == Request(command, request_id, ack, payload)
    assert request.acknowledge(b"abcd", Status.ACCESS_DENIED) == (
        b"U3VC" + struct.pack("<HHHH", 0x8006, (command + 1) & 0xFFFF, 4, request_id) + b"abcd"
    )
    assert request.pending(700) == b"U3VC" + struct.pack("<HHHHHH", 0, 0x0805, 4, request_id, 0, 700)


@given(st.binary(max_size=40))
def test_any_bytes_are_a_command_or_nothing(data: bytes) -> None:
    request = Request.from_bytes(data)
    assert request is None or data.startswith(b"U3VC")


@given(st.binary(max_size=20))
def test_any_payload_is_a_range_and_a_write_or_an_error(payload: bytes) -> None:
    for read in (u3vcp.memory_range, u3vcp.memory_write):
        try:
            read(payload)
        except CommandError as error:
            assert error.status in (Status.INVALID_HEADER, Status.INVALID_PARAMETER)


@pytest.mark.parametrize(("count", "fits"), [(0, False), (1, True), (1012, True), (1013, False)])
def test_no_more_is_read_than_an_acknowledgement_holds(count: int, fits: bool) -> None:
    payload = struct.pack("<QHH", 0x1000, 0, count)
    if fits:
        assert u3vcp.memory_range(payload) == (0x1000, count)
    else:
        with pytest.raises(CommandError):
            u3vcp.memory_range(payload)


@pytest.mark.parametrize(("has_chunks", "payload_type"), [(False, 0x0001), (True, 0x4001)])
def test_the_leader_says_what_comes(has_chunks: bool, payload_type: int) -> None:
    leader = u3vsp.leader(FRAME, has_chunks)
    assert len(leader) == 52
    magic, size, block, kind, time_ns = struct.unpack_from("<4s2xHQ2xHQ", leader)
    assert (magic, size, block, kind, time_ns) == (b"U3VL", 52, 7, payload_type, 123_456_789_012)
    assert struct.unpack_from("<IIIII", leader, 28) == (0x01080001, 720, 540, 0, 0)


@pytest.mark.parametrize(("sent", "status"), [(388800, 0x0000), (1000, 0xA100)])
def test_the_trailer_says_whether_all_of_it_came(sent: int, status: int) -> None:
    trailer = u3vsp.trailer(FRAME, True, sent, 388800)
    magic, size, block, code, valid, height = struct.unpack_from("<4s2xHQH2xQI", trailer)
    assert (magic, size, block, code, valid, height) == (b"U3VT", len(trailer), 7, status, sent, 540)
    assert len(trailer) == u3vsp.MAX_TRAILER_BYTES
    assert len(u3vsp.trailer(FRAME, False, sent, 388800)) == 32


@given(st.binary(min_size=48, max_size=48))
def test_any_header_is_a_word_or_an_error(header: bytes) -> None:
    try:
        word = messages.parse(header)
    except messages.ProtocolError:
        return
    assert word.sequence == int.from_bytes(header[4:8], "big")


@given(st.integers(0, 15), st.booleans(), st.integers(0, 2**32 - 1), st.binary(min_size=8, max_size=8))
def test_a_transfer_is_read(endpoint: int, is_in: bool, length: int, setup: bytes) -> None:
    header = struct.pack(">IIIIIIIIII", 1, 99, 0, is_in, endpoint, 0, length, 0, 0xFFFFFFFF, 0) + setup
    word = messages.parse(header)
    assert word == messages.Submit(99, endpoint | 0x80 * is_in, length, setup)
    assert word.data_bytes == (0 if is_in else length)


def test_answers_have_the_size_of_a_header() -> None:
    answers = (messages.submitted(1, -32, 5), messages.unlinked(1, -104), messages.claimed(1, -16))
    assert [len(answer) for answer in answers] == [messages.HEADER_BYTES] * 3
    assert [int.from_bytes(answer[20:24], "big", signed=True) for answer in answers] == [-32, -104, -16]


IDENTITY = Identity("Autoexpose", "FakeU3V287M", "FAKE-LEFT", "1.0", "bow")
CONFIGURATION, INTERFACE, ENDPOINT, ASSOCIATION, COMPANION, DEVICE_INFO = 0x02, 0x04, 0x05, 0x0B, 0x30, 0x24


def walk(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The descriptors in a configuration by type, each as long as it says."""
    while data:
        length, kind = data[0], data[1]
        assert 2 <= length <= len(data)
        yield kind, data[:length]
        data = data[length:]


def test_the_device_is_a_composite_super_speed_device() -> None:
    device = descriptors.device_descriptor()
    assert device[0] == len(device) == 18
    assert struct.unpack_from("<H", device, 2) == (0x0300,)
    assert tuple(device[4:7]) == (0xEF, 0x02, 0x01)
    assert 1 << device[7] == 512
    assert [text(index) for index in device[14:17]] == ["Autoexpose", "FakeU3V287M", "FAKE-LEFT"]
    assert descriptors.string_descriptor(IDENTITY, 9) is None


def test_the_configuration_is_one_function_of_three_interfaces() -> None:
    data = descriptors.configuration_descriptor()
    kinds = [kind for kind, _ in walk(data)]
    endpoint = [ENDPOINT, COMPANION]
    assert kinds == [
        CONFIGURATION,
        ASSOCIATION,
        *(INTERFACE, DEVICE_INFO, *endpoint, *endpoint),
        *(INTERFACE, *endpoint),
        *(INTERFACE, *endpoint),
    ]
    assert struct.unpack_from("<H", data, 2) == (len(data),)
    assert data[4] == kinds.count(INTERFACE) == 3
    interfaces = [item for kind, item in walk(data) if kind == INTERFACE]
    assert [tuple(item[2:9:2]) for item in interfaces] == [(0, 2, 5, 0), (1, 1, 5, 0), (2, 1, 5, 0)]
    assert [tuple(item[5:8]) for item in interfaces] == [(0xEF, 0x05, part) for part in range(3)]
    assert [item[2] for kind, item in walk(data) if kind == ENDPOINT] == [0x81, 0x01, 0x82, 0x83]


def test_the_guid_is_where_clients_look_for_it() -> None:
    (info,) = [item for kind, item in walk(descriptors.configuration_descriptor()) if kind == DEVICE_INFO]
    assert len(info) == 20
    other = Identity("Autoexpose", "FakeU3V287M", "FAKE-RIGHT", "1.0", "")
    assert text(info[11]) == IDENTITY.guid != other.guid
    assert len(f"{int(IDENTITY.guid, 16):012X}") == len(IDENTITY.guid) == 12
    assert [text(index) for index in info[12:15]] == ["Autoexpose", "FakeU3V287M", "Fake"]
    assert text(info[17]) == "FAKE-LEFT"
    assert text(info[18]) == "bow"


def text(index: int) -> str:
    descriptor = descriptors.string_descriptor(IDENTITY, index)
    assert descriptor is not None
    assert (descriptor[0], descriptor[1]) == (len(descriptor), 0x03)
    return descriptor[2:].decode("utf-16-le")


def test_the_object_store_tells_super_speed() -> None:
    store = descriptors.object_store_descriptor()
    assert struct.unpack_from("<HB", store, 2) == (len(store), 2)
    capabilities = [item for _, item in walk(store[5:])]
    assert [item[2] for item in capabilities] == [0x02, 0x03]
    assert struct.unpack_from("<H", capabilities[1], 4) == (1 << 3,)


PACKET = 1024


class Host:
    """Asks an endpoint for data and keeps what it gets."""

    def __init__(self) -> None:
        self.endpoint = InEndpoint()
        self.got: list[tuple[int, bytes]] = []

    def ask(self, length: int) -> ReadRequest:
        request = ReadRequest(length, lambda status, data: self.got.append((status, bytes(data))))
        self.endpoint.submit(request)
        return request


@given(st.lists(st.binary(min_size=1, max_size=3 * PACKET), max_size=8), st.booleans())
def test_each_transfer_ends_one_of_the_hosts(transfers: list[bytes], data_first: bool) -> None:
    host = Host()
    requests = [4 * PACKET] * len(transfers)
    if data_first:
        host.endpoint.write(*transfers)
    for length in requests:
        host.ask(length)
    if not data_first:
        host.endpoint.write(*transfers)
    assert host.got == [(0, transfer) for transfer in transfers]
    assert host.endpoint.backlog_bytes == 0


@given(st.binary(min_size=1, max_size=20 * PACKET), st.integers(1, 4))
def test_a_long_transfer_goes_on_in_the_next(transfer: bytes, packets: int) -> None:
    host = Host()
    host.endpoint.write(transfer)
    while host.endpoint.backlog_bytes:
        host.ask(packets * PACKET)
    assert b"".join(data for _, data in host.got) == transfer
    assert all(status == 0 for status, _ in host.got)


def test_a_buffer_too_short_for_a_packet_overflows() -> None:
    host = Host()
    host.endpoint.write(bytes(2000))
    host.ask(1500)
    assert host.got == [(-errno.EOVERFLOW, bytes(1500))]


def test_a_request_is_taken_back_once() -> None:
    host = Host()
    request = host.ask(PACKET)
    assert host.endpoint.cancel(request)
    assert not host.endpoint.cancel(request)
    host.endpoint.write(b"data")
    assert host.got == []
    assert host.endpoint.backlog_bytes == 4
    assert not host.endpoint.cancel(host.ask(PACKET))  # it was answered


def test_a_halted_endpoint_stalls_until_it_is_cleared() -> None:
    host = Host()
    host.ask(PACKET)
    host.endpoint.halt()
    host.ask(PACKET)
    host.endpoint.write(b"lost")
    assert host.got == [(-errno.EPIPE, b"")] * 2
    host.endpoint.clear_halt()
    host.ask(PACKET)
    host.endpoint.write(b"data")
    assert host.got[-1] == (0, b"data")


@pytest.mark.parametrize("forget", ["flush", "halt", "reset"])
def test_what_was_not_fetched_is_forgotten(forget: str) -> None:
    host = Host()
    host.endpoint.write(b"old")
    getattr(host.endpoint, forget)()
    host.endpoint.clear_halt()
    host.ask(PACKET)
    host.endpoint.write(b"new")
    assert host.got == [(0, b"new")]
