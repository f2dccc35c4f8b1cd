from __future__ import annotations

import socket
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.host.network import ActionSender, action_command, refusal
from drivers.setup import ActionKeys
from fake_camera.gige import gvcp

U32 = st.integers(0, (1 << 32) - 1)


@given(U32, U32, U32, st.integers(0, (1 << 64) - 1), st.integers(1, 0xFFFF))
def test_a_camera_reads_what_was_meant(device: int, group: int, mask: int, time_ns: int, request_id: int) -> None:
    """The fake's own parser, which shares no code with the sender."""
    request = gvcp.Request.from_bytes(action_command(ActionKeys(device, group, mask), time_ns, request_id))
    assert request is not None
    assert (request.command, request.request_id, request.ack_required) == (gvcp.Command.ACTION, request_id, True)
    assert gvcp.Action.from_request(request) == gvcp.Action(device, group, mask, time_ns)


@given(st.binary(max_size=40))
@example(struct.pack(">HHHH", 0, 0x0101, 0, 7))
@example(struct.pack(">HHHH", 0x8016, 0x0081, 0, 7))
def test_only_answers_to_actions_that_name_an_error_are_refusals(datagram: bytes) -> None:
    status, answered = struct.unpack(">HH", datagram[:4]) if len(datagram) >= 8 else (0, 0)
    assert (refusal(datagram) is not None) == (answered == 0x0101 and status != 0)


def test_a_sender_without_a_way_to_its_camera_leaves_no_socket_open() -> None:
    with pytest.raises(OSError, match=r"Permission denied|Network is unreachable"):  # the latter without a route
        ActionSender("255.255.255.255")


def test_refusals_are_told_in_words_with_the_next_commands_each_once() -> None:
    """The answers to commands that were sent in a burst, after a pause."""
    answers = ((0x8015, "keeps no more"), (0, None), (0x8016, "too late"), (0x8013, "never set"), (0x8001, "0x8001"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
        camera.bind(("127.0.0.1", 0))
        camera.settimeout(10)
        sender = ActionSender("127.0.0.1", camera.getsockname()[1])
        assert sender.send(ActionKeys(1, 1, 1), 5) is None
        _, peer = camera.recvfrom(100)
        for status, _ in answers:
            camera.sendto(struct.pack(">HHHH", status, 0x0101, 0, 1), peer)
        for words in (words for _, words in answers if words is not None):
            assert words in str(sender.send(ActionKeys(1, 1, 1), 6))
        assert sender.send(ActionKeys(1, 1, 1), 6) is None
        sender.close()
