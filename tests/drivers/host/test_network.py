"""Network facts, from what psutil says of a host; and action commands."""

from __future__ import annotations

import socket
import struct
from ipaddress import IPv4Interface
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.host.network import (
    USABLE_SHARE,
    ActionSender,
    NetworkInterface,
    action_command,
    bytes_per_s,
    find_interfaces,
    largest_socket_buffer_bytes,
    needed_bytes_per_s,
    packet_delay_ns,
    refusal,
)
from drivers.setup import ActionKeys
from fake_camera.gige import gvcp


class Host:
    """A host's interfaces, as psutil shows them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._addresses: dict[str, list[SimpleNamespace]] = {}
        self._stats: dict[str, SimpleNamespace] = {}
        monkeypatch.setattr(psutil, "net_if_addrs", lambda: self._addresses)
        monkeypatch.setattr(psutil, "net_if_stats", lambda: self._stats)

    def add(self, label: str, *addresses: str, is_up: bool = True, speed: int = 1000, mtu: int = 1500) -> None:
        link = SimpleNamespace(family=socket.AF_PACKET, address="02:fc:00:00:00:01", netmask=None)
        ipv6 = SimpleNamespace(family=socket.AF_INET6, address="fe80::1", netmask="ffff:ffff:ffff:ffff::")
        pairs = [IPv4Interface(address).with_netmask.split("/") for address in addresses]
        ipv4 = [SimpleNamespace(family=socket.AF_INET, address=address, netmask=mask) for address, mask in pairs]
        self._addresses[label] = [*ipv4, ipv6, link]
        self._stats[label] = SimpleNamespace(isup=is_up, speed=speed, mtu=mtu)


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Host:
    return Host(monkeypatch)


def addresses(*texts: str) -> tuple[IPv4Interface, ...]:
    return tuple(IPv4Interface(text) for text in texts)


def test_interfaces_that_are_up_and_have_an_address_are_found(host: Host) -> None:
    host.add("lo", "127.0.0.1/8", speed=0, mtu=65536)
    host.add("eth0", "192.168.7.1/24")
    host.add("eth1")
    host.add("eth2", "192.168.8.1/24", is_up=False)
    assert find_interfaces() == [
        NetworkInterface("eth0", addresses("192.168.7.1/24"), 1500, 1000),
        NetworkInterface("lo", addresses("127.0.0.1/8"), 65536, None),
    ]


def test_an_interface_keeps_all_its_addresses(host: Host) -> None:
    host.add("eth0", "192.168.7.1/24", "169.254.3.4/16")
    host.add("eth0:1", "10.0.0.1/8")
    (interface,) = find_interfaces()
    assert interface.addresses == addresses("192.168.7.1/24", "169.254.3.4/16", "10.0.0.1/8")


def test_the_socket_buffer_limit_is_read(tmp_path: Path) -> None:
    assert largest_socket_buffer_bytes(tmp_path) is None
    file = tmp_path / "proc/sys/net/core/rmem_max"
    file.parent.mkdir(parents=True)
    file.write_text("212992\n")
    assert largest_socket_buffer_bytes(tmp_path) == 212992


@given(st.integers(576, 9000), st.floats(10.0, 10_000.0), st.integers(1, 4), st.none() | st.floats(1e6, 1.25e9))
def test_cameras_that_pause_so_long_fit_into_the_link(
    packet_bytes: int, mbps: float, count: int, own_bytes_per_s: float | None
) -> None:
    share = bytes_per_s(mbps, count)
    delay_s = 1e-9 * packet_delay_ns(packet_bytes, share, own_bytes_per_s)
    sending_s = 0.0 if own_bytes_per_s is None else (packet_bytes + 38) / own_bytes_per_s
    sent = count * (packet_bytes + 38) / (delay_s + sending_s)
    assert sent <= USABLE_SHARE * mbps * 1e6 / 8 * (1 + 1e-6)
    if own_bytes_per_s is not None and own_bytes_per_s < share:
        assert delay_s == 0.0


def test_a_frame_needs_its_packets_headers_too() -> None:
    # 720 x 540 in packets of 1500 bytes: 1464 of them image, with 36 + 38 bytes around
    assert needed_bytes_per_s(388_800, 1500, 60.0) == pytest.approx(60.0 * (388_800 + 266 * 74))


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
