"""Questions to GigE Vision cameras: fake ones on the loopback, and datagrams that no sound camera sends."""

from __future__ import annotations

import contextlib
import itertools
import select
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import IPv4Interface

import pytest

from drivers.aravis import find_cameras, open_camera
from drivers.host import network as gvcp
from drivers.host.network import (
    Control,
    GigeCamera,
    NetworkInterface,
    addresses_of,
    control_of,
    find_interfaces,
    ptp_status_of,
    search,
    streamed_packet_bytes,
)
from drivers.setup import CameraSetup, TriggerSetup
from tests.fake_camera.gige.gige_client import ACCESS_DENIED, CCP, READREG, GvcpClient, gige_camera, parse_ack
from tests.fakes import foreign_camera, loopback_address, unique

LO = NetworkInterface("lo", (IPv4Interface("127.0.0.1/8"),), 65536, None)


def find(serial: str, interfaces: list[NetworkInterface]) -> GigeCamera:
    (camera,) = (camera for camera in search(interfaces).cameras if camera.serial == serial)
    return camera


def test_a_camera_is_found_with_its_names_and_interface() -> None:
    address, serial = loopback_address(), unique("T")
    with gige_camera(address, serial):
        camera = find(serial, [LO])
        assert camera == GigeCamera(serial, camera.vendor, camera.model, IPv4Interface(f"{address}/8"), LO)
        assert camera.vendor
        assert camera.model
        assert camera.reachable
        # Other interfaces may bring its answer, too; the one that reaches it counts.
        assert find(serial, find_interfaces()).interface.name == "lo"


@pytest.mark.parametrize(("subnets", "reachable"), [(["127.0.0.1/32"], False), (["127.0.0.1/32", "127.0.0.1/8"], True)])
def test_a_camera_is_in_reach_of_an_interface_that_has_an_address_in_its_subnet(
    subnets: list[str], reachable: bool
) -> None:
    interface = NetworkInterface("lo", tuple(map(IPv4Interface, subnets)), 65536, None)
    serial = unique("T")
    with gige_camera(loopback_address(), serial):
        assert find(serial, [interface]).reachable == reachable


def test_a_wanted_camera_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine a fake camera may not answer at once."""
    serial, asked, ask = unique("T"), itertools.count(1), gvcp._ask_everyone
    with contextlib.ExitStack() as cameras:

        def also_begin(asker: socket.socket, interface: NetworkInterface) -> None:
            if next(asked) == 2:
                cameras.enter_context(gige_camera(loopback_address(), serial))
            ask(asker, interface)

        monkeypatch.setattr(gvcp, "_ask_everyone", also_begin)
        found = search([LO], wanted=[serial])
    assert serial in [camera.serial for camera in found.cameras]
    assert next(asked) == 3


def test_answers_count_that_a_busy_process_finds_after_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    serial, ask = unique("T"), gvcp._ask_everyone

    def and_wait(asker: socket.socket, interface: NetworkInterface) -> None:
        ask(asker, interface)
        assert select.select([asker], [], [], 10)[0]

    monkeypatch.setattr(gvcp, "_ask_everyone", and_wait)
    with gige_camera(loopback_address(), serial):
        assert search([LO], wait_s=0.0).cameras


def test_an_interface_that_cannot_be_searched_is_told_and_does_not_hinder_the_others() -> None:
    gone = NetworkInterface("no-such-if", (IPv4Interface("10.255.0.1/24"),), 1500, None)
    serial = unique("T")
    with gige_camera(loopback_address(), serial):
        found = search([gone, LO])
    assert serial in [camera.serial for camera in found.cameras]
    assert list(found.failures) == ["no-such-if"]
    assert found.failures["no-such-if"]


def test_control_is_seen_from_outside() -> None:
    address = loopback_address()
    with gige_camera(address), GvcpClient(address) as client:
        for privilege, control in ((0, "free"), (2, "held"), (1, "held"), (0, "free")):
            client.write(CCP, privilege)
            assert control_of(address) == control


def test_the_state_of_a_ptp_clock_is_read_without_control() -> None:
    address = loopback_address()
    with gige_camera(address, unique("T"), ptp_clock=0x0200_00FF_FE00_0001):
        assert ptp_status_of(address) == "Disabled"
    with gige_camera(address, unique("T")):
        assert ptp_status_of(address) is None
    assert ptp_status_of(address, answer_s=0.01) is None


@pytest.mark.wire
def test_aravis_finds_the_same_camera() -> None:
    serial = unique("T")
    with gige_camera(loopback_address(), serial):
        ours = find(serial, [LO])
        (theirs,) = (camera for camera in find_cameras() if camera.serial == serial)
    assert (ours.serial, ours.vendor, ours.model) == (theirs.serial, theirs.vendor, theirs.model)
    assert str(ours.address.ip) == theirs.address


@pytest.mark.wire
def test_a_camera_that_we_did_not_write_answers() -> None:
    with foreign_camera() as serial:
        camera = find(serial, [LO])
        assert camera.reachable
        assert control_of(str(camera.address.ip)) == "free"
        with contextlib.closing(open_camera(serial, CameraSetup(TriggerSetup("free_run", rate_hz=25.0)))):
            assert control_of(str(camera.address.ip)) == "held"
        assert control_of(str(camera.address.ip)) == "free"


INVALID_ADDRESS, BUSY = 0x8003, 0x8007


@contextmanager
def answering(address: str, answer: bytes) -> Iterator[list[bytes]]:
    """Something at a camera's port that gives one answer to everything, until the first empty datagram.

    With the id of the question, if there is room for one. Yields the questions.
    """
    questions: list[bytes] = []

    def serve() -> None:
        while True:
            question, peer = server.recvfrom(2048)
            if not question:
                return
            questions.append(question)
            server.sendto(answer[:6] + question[6:8] + answer[8:] if len(answer) >= 8 else answer, peer)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind((address, gvcp.PORT))
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield questions
        finally:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ending:
                ending.sendto(b"", (address, gvcp.PORT))
            thread.join()


@pytest.mark.parametrize(
    ("answer", "control"),
    [
        (struct.pack(">HHHHI", 0, READREG + 1, 4, 1, 0x2), "held"),
        (struct.pack(">HHHHI", 0, READREG + 1, 4, 1, 0x0), "free"),
        (struct.pack(">HHHH", ACCESS_DENIED, READREG + 1, 0, 1), "held"),
        (struct.pack(">HHHH", INVALID_ADDRESS, READREG + 1, 0, 1), "silent"),
        (struct.pack(">HHHH", 0, READREG + 1, 0, 1), "silent"),
        (b"\0\0", "silent"),
        (b"HTTP/1.1 400 Bad Request", "silent"),
    ],
)
def test_answers_are_read_for_what_they_are(answer: bytes, control: Control) -> None:
    address = loopback_address()
    assert control_of(address, answer_s=0.01) == "silent"
    with answering(address, answer):
        assert control_of(address) == control


@pytest.mark.parametrize(("status", "answer_s", "asked"), [(INVALID_ADDRESS, 20.0, 1), (BUSY, 0.2, gvcp.TRIES)])
def test_a_camera_that_has_no_such_register_is_not_asked_again_and_a_busy_one_is(
    status: int, answer_s: float, asked: int
) -> None:
    address = loopback_address()
    with answering(address, struct.pack(">HHHH", status, READREG + 1, 0, 1)) as questions:
        ptp_status = ptp_status_of(address, answer_s)
    assert ptp_status is None
    assert len(questions) == asked


def test_answers_to_other_questions_are_none() -> None:
    """Whoever would pass for a camera at another address must guess the id of the question."""
    address, found = loopback_address(), list[frozenset[str]]()
    asking = threading.Thread(target=lambda: found.append(addresses_of(address, answer_s=10.0)))
    with contextlib.ExitStack() as stack:
        server, liar = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        server.bind((address, gvcp.PORT))
        asking.start()
        question, peer = server.recvfrom(100)
        for request_id in range(0, 0x10000, 1021):
            if request_id != int.from_bytes(question[6:8], "big"):
                liar.sendto(struct.pack(">HHHHI", 0, READREG + 1, 4, request_id, 1), peer)
        server.sendto(struct.pack(">HHH", 0, READREG + 1, 4) + question[6:8] + bytes([0, 0, 0, 1]), peer)
        question, peer = server.recvfrom(100)
        server.sendto(struct.pack(">HHH", 0, READREG + 1, 4) + question[6:8] + bytes([10, 0, 0, 5]), peer)
        asking.join()
    assert found == [{address, "10.0.0.5"}]


def test_a_camera_names_the_addresses_of_all_its_interfaces() -> None:
    first, second = loopback_address(), loopback_address()
    with gige_camera(first, unique("T")):
        assert addresses_of(first) == {first}
    with gige_camera(first, unique("T"), second_address=second):
        assert addresses_of(first) == {first, second}
    assert addresses_of(first, answer_s=0.01) == frozenset()


def test_an_answer_from_another_address_gives_it_away() -> None:
    """A camera, or a network between, that answers for the address that was asked."""
    asked, answers = loopback_address(), loopback_address()

    def serve() -> None:
        for value in (1, 0):
            question, peer = server.recvfrom(100)
            elsewhere.sendto(struct.pack(">HHH", 0, READREG + 1, 4) + question[6:8] + struct.pack(">I", value), peer)

    with contextlib.ExitStack() as stack:
        server, elsewhere = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        server.bind((asked, gvcp.PORT))
        elsewhere.bind((answers, 0))
        serving = threading.Thread(target=serve)
        serving.start()
        assert addresses_of(asked) == {answers}
        serving.join()


def test_the_packets_of_a_stream_are_measured_while_it_runs() -> None:
    address = loopback_address()
    with gige_camera(address, unique("T")), GvcpClient(address) as client:
        assert streamed_packet_bytes(address) is None
        client.write(CCP, 2)
        client.write(0x0D00, 40_000, 0x0D04, 8000)
        assert streamed_packet_bytes(address) == 8000
    assert streamed_packet_bytes(address, answer_s=0.01) is None


def identity(**fields: bytes) -> bytes:
    """The acknowledgement of a search, with fields of the bootstrap registers by their address."""
    memory = bytearray(0xF8)
    for at, data in ((int(name[1:], 16), data) for name, data in fields.items()):
        memory[at : at + len(data)] = data
    datagram = struct.pack(">HHHH", 0, 3, len(memory), 1) + memory
    assert parse_ack(datagram)[3] == memory
    return datagram


def test_what_a_camera_says_of_itself_may_be_incomplete_or_none() -> None:
    nameless = identity(x0A=bytes.fromhex("0011e2a1b2c3"), x24=b"\xc0\xa8\x07\x05", x34=b"\xff\xff\xff\0")
    camera = gvcp._read_identity(nameless, LO)
    assert camera is not None
    assert (camera.serial, camera.address) == ("00:11:e2:a1:b2:c3", IPv4Interface("192.168.7.5/24"))
    camera = gvcp._read_identity(identity(xD8=b"S", x24=b"\xc0\xa8\x07\x05", x34=b"\xff\0\xff\0"), LO)
    assert camera is not None
    assert camera.address == IPv4Interface("192.168.7.5/32")  # its netmask is none
    for datagram in (b"", b"\0" * 8, identity()[:-1], b"\x80\x06" + identity()[2:]):
        assert gvcp._read_identity(datagram, LO) is None
