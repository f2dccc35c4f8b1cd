"""The message channel: how events are sent, and again until they are acknowledged."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator

import pytest

from fake_camera.gige.gvcp import event
from fake_camera.gige.message_channel import MessageChannel

EVENTDATA = 0x00C2
ITEM = event(0x9001, 5, 123, b"12345678")


@contextlib.contextmanager
def connected(timeout_ms: int) -> Iterator[tuple[MessageChannel, socket.socket]]:
    """A channel, and the client's end of it."""
    channel = MessageChannel("127.0.0.1")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.1", 0))
        client.settimeout(10)
        channel.timeout_ms, channel.retries = timeout_ms, 2
        channel.destination = 0x7F000001
        channel.host_port = client.getsockname()[1]
        try:
            yield channel, client
        finally:
            channel.close()


def message(request_id: int, *, ack_required: bool = True) -> bytes:
    return struct.pack(">BBHHH", 0x42, ack_required, EVENTDATA, len(ITEM), request_id) + ITEM


def test_an_event_has_its_id_its_block_and_its_time_first() -> None:
    assert struct.pack(">HHHHQ", 0, 0x9001, 0, 5, 123) + b"12345678" == ITEM


def test_an_event_is_repeated_until_it_is_acknowledged() -> None:
    with connected(timeout_ms=50) as (channel, client):
        channel.send(ITEM)
        channel.send(ITEM)
        assert client.recv(100) == message(1)
        repeated, peer = client.recvfrom(100)
        assert repeated == message(1)
        assert peer[1] == channel.source_port
        for acknowledged, request_id in ((EVENTDATA + 1, 9), (0x81, 1), (EVENTDATA + 1, 1)):  # only the last is one
            client.sendto(struct.pack(">HHHH", 0, acknowledged, 0, request_id), peer)
        assert client.recv(100) == message(2)


def test_an_event_that_nobody_acknowledges_is_given_up() -> None:
    with connected(timeout_ms=10) as (channel, client):
        channel.send(ITEM)
        channel.send(ITEM)
        assert [client.recv(100) for _ in range(6)] == [message(1)] * 3 + [message(2)] * 3


def test_without_a_timeout_no_acknowledgement_is_asked_for() -> None:
    with connected(timeout_ms=0) as (channel, client):
        for request_id in (1, 2):
            channel.send(ITEM)
            assert client.recv(100) == message(request_id, ack_required=False)


def test_without_a_client_nothing_is_sent() -> None:
    with connected(timeout_ms=0) as (channel, client):
        port, channel.host_port = channel.host_port, 0
        channel.send(ITEM)
        channel.host_port = port
        channel.send(ITEM)
        assert client.recv(100) == message(1, ack_required=False)
        client.settimeout(0.05)
        with pytest.raises(TimeoutError):
            client.recv(100)
