"""What a camera sends: its stream, its events, and what a switch lets through."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fake_camera.device.faults import Fault, FaultOrder, Faults
from fake_camera.genicam.chunks import CHUNKS, chunk_bytes
from fake_camera.genicam.status import CommandError
from fake_camera.gige.gvcp import Resend, event
from fake_camera.gige.gvsp import Block, block_id
from fake_camera.gige.message_channel import MessageChannel
from fake_camera.gige.stream_channel import StreamChannel
from fake_camera.gige.switch import Switch
from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame, ImageSettings
from tests.fake_camera.gige.gige_client import ramp

LEADER, TRAILER, PAYLOAD = 1, 2, 3
RESENT, UNAVAILABLE = 0x0100, 0x800C
FIRE_TEST_PACKET = 1 << 31


def exposed(width: int = 720, height: int = 540, pixel_format: str = "Mono8", frame_id: int = 1) -> ExposedFrame:
    image = ImageSettings(1234.5, 6.02, 0.0, 1.0, pixel_format, 8, 4, width, height, 1, 1)
    return ExposedFrame(frame_id, None, 0x0000000123456789, ramp(width, height, pixel_format), image)


def header(packet: bytes) -> tuple[int, int, int, int]:
    """Status, block id, format and packet id."""
    status, block, rest = struct.unpack_from(">HHI", packet)
    return status, block, rest >> 24, rest & 0xFFFFFF


def test_block_ids_skip_zero() -> None:
    assert [block_id(frame_id) for frame_id in (1, 2, 65535, 65536, 65537, 131070, 131071)] == [
        1, 2, 65535, 1, 2, 65535, 1,
    ]  # fmt: skip


@settings(max_examples=60)
@given(
    width=st.integers(1, 200),
    height=st.integers(1, 60),
    pixel_format=st.sampled_from(sorted(PIXEL_FORMATS)),
    packet_bytes=st.integers(220, 9000),
    names=st.none() | st.lists(st.sampled_from(sorted(CHUNKS)), unique=True),
)
def test_packets_put_together_are_the_frame(
    width: int, height: int, pixel_format: str, packet_bytes: int, names: list[str] | None
) -> None:
    frame = exposed(width, height, pixel_format)
    chunks = b"" if names is None else chunk_bytes(frame, names, "big")
    block = Block.from_frame(frame, chunks, packet_bytes)
    packets = [b"".join(block.packet(packet_id)) for packet_id in range(block.last_packet_id + 1)]

    formats = [LEADER, *[PAYLOAD] * (len(packets) - 2), TRAILER]
    assert [header(packet) for packet in packets] == [(0, 1, form, n) for n, form in enumerate(formats)]
    assert all(len(packet) + 28 <= packet_bytes for packet in packets)
    assert all(len(packet) + 28 == packet_bytes for packet in packets[1:-2])
    sent = b"".join(packet[8:] for packet in packets[1:-1])
    assert sent == bytes(PIXEL_FORMATS[pixel_format].on_the_wire(frame.pixels)) + chunks


def test_leader_and_trailer_of_an_image() -> None:
    block = Block.from_frame(exposed(), b"", 9000)
    leader = struct.unpack(">HHQIIIIIHH", b"".join(block.packet(0))[8:])
    assert leader == (0, 1, 0x123456789, 0x01080001, 720, 540, 8, 4, 0, 0)
    assert b"".join(block.packet(block.last_packet_id))[8:] == struct.pack(">HHI", 0, 1, 540)


class Client:
    """A stream channel and the client's end of it."""

    def __init__(self) -> None:
        self.faults = Faults()
        self.channel = StreamChannel("127.0.0.1", self.faults)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self.socket.bind(("127.0.0.1", 0))
        self.channel.destination = 0x7F000001
        self.channel.host_port = self.socket.getsockname()[1]

    def received(self) -> list[bytes]:
        """What has come so far; loopback delivers within the sender's call."""
        packets = []
        while True:
            try:
                packets.append(self.socket.recv(0x10000, socket.MSG_DONTWAIT))
            except BlockingIOError:
                return packets


@pytest.fixture
def client() -> Iterator[Client]:
    client = Client()
    yield client
    client.channel.close()
    client.socket.close()


def test_nothing_is_sent_to_nobody(client: Client) -> None:
    client.channel.stop()
    client.channel.send(exposed(), b"")
    assert client.received() == []


def test_a_lost_packet_comes_again_when_asked_for(client: Client) -> None:
    client.faults.add(FaultOrder(Fault.LOSE_PACKETS, None, 2))
    client.channel.send(exposed(), b"")
    first = client.received()
    assert [header(packet)[3] for packet in first[:2]] == [2, 3]

    client.channel.resend(Resend(0, 1, 0, 1))
    again = client.received()
    assert [header(packet) for packet in again] == [(RESENT, 1, LEADER, 0), (RESENT, 1, PAYLOAD, 1)]
    assert b"".join(packet[8:] for packet in again[1:] + first[:-1]) == exposed().pixels.tobytes()
    last = header(first[-1])[3]
    client.channel.resend(Resend(0, 1, last - 1, 0xFFFFFF))
    assert [header(packet)[3] for packet in client.received()] == [last - 1, last]


def test_a_packet_size_is_kept_to_and_tested_when_asked_for(client: Client) -> None:
    for packet_bytes in (0, 219):
        with pytest.raises(CommandError):
            client.channel.packet_size_register = packet_bytes
        assert client.channel.packet_size_register & 0xFFFF == 9000
    client.channel.packet_size_register = 1400
    client.channel.send(exposed(), b"")
    assert {len(packet) for packet in client.received()[1:-2]} == {1400 - 28}
    for packet_bytes in (9001, 0xFFFF):  # too large: the largest is taken, and no test packet sent
        client.channel.packet_size_register = FIRE_TEST_PACKET | packet_bytes
        assert client.channel.packet_size_register == 9000
    client.channel.packet_size_register = FIRE_TEST_PACKET | 4000
    assert [len(packet) for packet in client.received()] == [4000 - 28]
    assert client.channel.packet_size_register == 4000


def test_eight_frames_are_kept_and_older_ones_are_not_to_be_had(client: Client) -> None:
    for frame_id in range(1, 10):
        client.channel.send(exposed(64, 4, frame_id=frame_id), b"")
    client.received()
    client.channel.resend(Resend(0, 2, 1, 1))
    client.channel.resend(Resend(0, 1, 1, 1))
    client.channel.resend(Resend(0, 9, 50, 60))
    assert [header(packet) for packet in client.received()] == [
        (RESENT, 2, PAYLOAD, 1),
        (UNAVAILABLE, 1, PAYLOAD, 1),
        (UNAVAILABLE, 9, PAYLOAD, 50),
    ]
    for frame_id in (65535, 65536):  # block ids begin again
        client.channel.send(exposed(64, 4, frame_id=frame_id), b"")
    client.received()
    for block in (65535, 1):
        client.channel.resend(Resend(0, block, 1, 1))
    assert [header(packet)[:2] for packet in client.received()] == [(RESENT, 65535), (RESENT, 1)]


def test_frames_of_a_former_acquisition_are_not_to_be_had(client: Client) -> None:
    for frame_id in (1, 2, 3):
        client.channel.send(exposed(64, 4, frame_id=frame_id), b"")
    client.received()
    newer = exposed(64, 4, "Mono12", frame_id=2)
    client.channel.send(newer, b"")
    sent = client.received()
    for wanted in (1, 2, 3):
        client.channel.resend(Resend(0, wanted, 1, 1))
    again = client.received()
    assert [header(packet)[:2] for packet in again] == [(UNAVAILABLE, 1), (RESENT, 2), (UNAVAILABLE, 3)]
    assert again[1][8:] == sent[1][8:] == newer.pixels.tobytes()


def test_of_a_truncated_frame_the_rest_is_not_to_be_had(client: Client) -> None:
    client.faults.add(FaultOrder(Fault.TRUNCATE))
    for frame_id in (1, 2):
        client.channel.send(exposed(frame_id=frame_id), b"")
    packets = [header(packet) for packet in client.received()]
    cut, whole = ([number for _, block, _, number in packets if block == frame_id] for frame_id in (1, 2))
    assert cut == [*whole[: len(whole) // 2], whole[-1]]
    client.channel.resend(Resend(0, 1, len(cut), len(cut)))
    assert [header(packet) for packet in client.received()] == [(UNAVAILABLE, 1, PAYLOAD, len(cut))]


def test_half_of_the_packets_go_through_and_of_those_sent_again_too(client: Client) -> None:
    client.faults.add(FaultOrder(Fault.LOSE_HALF, None, 1000))
    client.channel.packet_size_register = 1500
    client.channel.send(exposed(), b"")
    arrived = [header(packet)[3] for packet in client.received()]
    sent = 720 * 540 // (1500 - 36) + 3
    assert 0.3 * sent < len(arrived) < 0.7 * sent
    client.channel.resend(Resend(0, 1, 0, sent))
    assert 0.3 * sent < len(client.received()) < 0.7 * sent


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


MBPS, BUFFER_BYTES = 1000.0, 64 * 1024
PACKET = 8962  # 9000 with Ethernet's framing


def test_a_burst_fills_the_buffer_and_the_link_empties_it(tmp_path: Path) -> None:
    with Switch(tmp_path / "switch", MBPS, BUFFER_BYTES) as switch:
        passed = [switch.passes(PACKET, 0) for _ in range(10)]
        assert passed == [True] * 7 + [False] * 3 and switch.dropped == 3
        assert not switch.passes(PACKET, 50_000)  # 9000 bytes take 72 us
        assert switch.passes(PACKET, 72_000)
        assert switch.passes(PACKET, 10_000_000)


def test_cameras_share_it(tmp_path: Path) -> None:
    path = tmp_path / "switch"
    with Switch(path, MBPS, BUFFER_BYTES) as left, Switch(path, MBPS, BUFFER_BYTES) as right:
        assert [camera.passes(PACKET, 0) for camera in (left, right) * 5] == [True] * 7 + [False] * 3
    assert (left.dropped, right.dropped) == (1, 2)


@given(st.lists(st.tuples(st.integers(0, 10_000_000), st.integers(100, 9000)), min_size=1))
def test_no_more_gets_through_than_buffer_and_link_take(
    tmp_path_factory: pytest.TempPathFactory, packets: list[tuple[int, int]]
) -> None:
    times_ns = sorted(time_ns for time_ns, _ in packets)
    with Switch(tmp_path_factory.mktemp("switch") / "state", MBPS, BUFFER_BYTES) as switch:
        sizes = [size for _, size in packets]
        through = sum(size + 38 for time_ns, size in zip(times_ns, sizes, strict=True) if switch.passes(size, time_ns))
    assert through <= BUFFER_BYTES + (times_ns[-1] - times_ns[0]) * MBPS / 8e3


def test_threads_of_one_camera_take_turns(tmp_path: Path) -> None:
    """Frames and resent packets: a lock on a file does not keep threads of one process apart."""
    with Switch(tmp_path / "switch", MBPS, BUFFER_BYTES) as switch, ThreadPoolExecutor(8) as threads:
        passed = list(threads.map(lambda _: switch.passes(PACKET, 0), range(2000)))
    assert sum(passed) == 7 and switch.dropped == 1993
