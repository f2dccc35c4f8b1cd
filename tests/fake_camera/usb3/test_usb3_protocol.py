from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.features import Features
from fake_camera.genicam.status import CommandError, Status
from fake_camera.imaging import ExposedFrame
from fake_camera.usb3 import u3vcp, u3vsp
from fake_camera.usb3.u3vcp import Request
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
