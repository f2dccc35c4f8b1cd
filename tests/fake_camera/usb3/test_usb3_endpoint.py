from __future__ import annotations

import errno

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.usb3.usb.endpoint import InEndpoint, ReadRequest

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


def test_an_answered_request_is_not_taken_back() -> None:
    host = Host()
    request = host.ask(PACKET)
    host.endpoint.write(b"data")
    assert not host.endpoint.cancel(request)


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
