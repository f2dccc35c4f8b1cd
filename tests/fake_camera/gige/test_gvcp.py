"""The control channel: requests, control privilege, action commands."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.registers import Register, RegisterMap, constant, unsigned
from fake_camera.gige.actions import ActionChannel
from fake_camera.gige.control_channel import ControlChannel
from fake_camera.gige.gvcp import Request, Resend
from tests.fake_camera.gige.gige_client import (
    ACCESS_DENIED,
    ACTION,
    BAD_ALIGNMENT,
    CCP,
    DISCOVERY,
    FORCEIP,
    HEARTBEAT_TIMEOUT,
    INVALID_ADDRESS,
    INVALID_HEADER,
    INVALID_PARAMETER,
    NOT_IMPLEMENTED,
    PACKETRESEND,
    READMEM,
    READREG,
    WRITE_PROTECT,
    WRITEMEM,
    WRITEREG,
    GvcpClient,
    command,
    device,
    gige_camera,
    parse_ack,
)
from tests.fakes import loopback_address

ANNE, BERT = ("10.0.0.1", 5000), ("10.0.0.2", 5000)
EXCLUSIVE, CONTROL = 1, 2
VERSION, COUNTER, TEXT = 0x0000, 0x2000, 0x3000


@dataclass
class Camera:
    """A control channel over a small memory, on a clock of its own."""

    written: list[int] = field(default_factory=list)
    resends: list[Resend] = field(default_factory=list)
    releases: int = 0
    now_s: float = 100.0
    text: bytes = bytes(16)

    def __post_init__(self) -> None:
        self.privilege = ControlPrivilege()
        registers = RegisterMap(
            [
                constant(VERSION, bytes(0xF8)),
                unsigned(CCP, lambda: self.privilege.value),
                unsigned(COUNTER, lambda: len(self.written), self.written.append),
                Register(TEXT, 16, lambda: self.text, self._write_text),
            ]
        )
        self.channel = ControlChannel(registers, self.privilege, self.resends.append, self._release)

    def _write_text(self, data: bytes) -> None:
        self.text = data

    def _release(self) -> None:
        self.releases += 1

    def ask(
        self, number: int, payload: bytes = b"", peer: tuple[str, int] = ANNE, request_id: int = 1
    ) -> tuple[int, bytes]:
        answer = self.channel.answer(command(number, payload, request_id), peer, self.now_s)
        assert answer is not None
        status, ack, echoed_id, payload = parse_ack(answer)
        assert (ack, echoed_id) == (number + 1, request_id)
        return status, payload

    def write(self, address: int, value: int, peer: tuple[str, int] = ANNE, request_id: int = 1) -> int:
        return self.ask(WRITEREG, struct.pack(">II", address, value), peer, request_id)[0]

    def read(self, address: int, peer: tuple[str, int] = ANNE) -> tuple[int, bytes]:
        return self.ask(READREG, struct.pack(">I", address), peer)


@pytest.fixture
def camera() -> Iterator[Camera]:
    camera = Camera()
    assert camera.write(CCP, CONTROL) == 0
    yield camera


@given(
    number=st.integers(0, 0xFFFF),
    request_id=st.integers(1, 0xFFFF),
    ack=st.booleans(),
    payload=st.binary(max_size=600),
    padding=st.binary(max_size=20),
)
def test_request_is_read_as_it_was_packed(
    number: int, request_id: int, ack: bool, payload: bytes, padding: bytes
) -> None:
    datagram = command(number, payload, request_id, flags=int(ack)) + padding
    assert Request.from_bytes(datagram) == Request(number, request_id, ack, payload)


@given(
    number=st.sampled_from([DISCOVERY, PACKETRESEND, READREG, WRITEREG, READMEM, WRITEMEM, 0x0100, 0xFFFF]),
    payload=st.binary(max_size=40),
)
def test_any_payload_is_answered_or_ignored_but_never_fatal(number: int, payload: bytes) -> None:
    camera = Camera()
    camera.write(CCP, CONTROL, request_id=9)
    answer = camera.channel.answer(command(number, payload), ANNE, camera.now_s)
    if answer is not None:
        status, ack, request_id, _payload = parse_ack(answer)
        assert status == 0 or 0x8001 <= status <= 0x800E
        assert (ack, request_id) == ((number + 1) & 0xFFFF, 1)


@pytest.mark.parametrize(
    ("number", "payload", "status"),
    [
        (READREG, struct.pack(">I", 0x5000), INVALID_ADDRESS),
        (READREG, struct.pack(">I", 0x2002), BAD_ALIGNMENT),
        (READREG, b"\0\0", INVALID_HEADER),
        (WRITEREG, struct.pack(">II", 0x5000, 1), INVALID_ADDRESS),
        (WRITEREG, struct.pack(">II", VERSION, 1), WRITE_PROTECT),
        (WRITEREG, struct.pack(">II", TEXT, 1), BAD_ALIGNMENT),
        (READMEM, struct.pack(">IHH", VERSION, 0, 2), BAD_ALIGNMENT),
        (READMEM, struct.pack(">IHH", VERSION, 0, 540), INVALID_PARAMETER),
        (READMEM, struct.pack(">IHH", 0xF0, 0, 12), INVALID_ADDRESS),
        (WRITEMEM, struct.pack(">I", TEXT) + bytes(12), BAD_ALIGNMENT),
        (WRITEMEM, struct.pack(">I", TEXT), INVALID_HEADER),
        (0x0100, b"", NOT_IMPLEMENTED),
    ],
)
def test_error_status(camera: Camera, number: int, payload: bytes, status: int) -> None:
    assert camera.ask(number, payload)[0] == status


def test_several_registers_are_written_in_one_command_up_to_the_first_that_is_refused(camera: Camera) -> None:
    assert camera.ask(WRITEREG, struct.pack(">IIII", COUNTER, 7, COUNTER, 8)) == (0, struct.pack(">HH", 0, 2))
    assert camera.ask(READREG, struct.pack(">II", COUNTER, CCP)) == (0, struct.pack(">II", 2, CONTROL))
    writes = struct.pack(">IIIIII", COUNTER, 9, 0x5000, 1, COUNTER, 8)
    assert camera.ask(WRITEREG, writes, request_id=2) == (INVALID_ADDRESS, struct.pack(">HH", 0, 1))
    assert camera.written == [7, 8, 9]


def test_memory_is_written_and_read_back(camera: Camera) -> None:
    text = b"sixteen letters."
    assert camera.ask(WRITEMEM, struct.pack(">I", TEXT) + text) == (0, struct.pack(">HH", 0, 16))
    where = struct.pack(">I", TEXT + 4)
    assert camera.ask(READMEM, where + struct.pack(">HH", 0, 8)) == (0, where + text[4:12])


def test_a_retried_write_is_answered_but_not_done_again(camera: Camera) -> None:
    assert camera.write(COUNTER, 5, request_id=7) == 0
    assert camera.write(COUNTER, 5, request_id=7) == 0
    assert camera.written == [5]
    assert camera.write(COUNTER, 5, request_id=8) == 0
    assert camera.written == [5, 5]


def test_a_command_that_wants_no_answer_gets_none(camera: Camera) -> None:
    datagram = command(WRITEREG, struct.pack(">II", COUNTER, 3), request_id=2, flags=0)
    assert camera.channel.answer(datagram, ANNE, camera.now_s) is None
    assert camera.written == [3]
    assert camera.channel.answer(command(FORCEIP, bytes(56)), ANNE, camera.now_s) is None


def test_control_lets_others_read_but_not_write(camera: Camera) -> None:
    assert camera.read(COUNTER, BERT) == (0, bytes(4))
    assert camera.write(COUNTER, 1, BERT) == ACCESS_DENIED
    assert camera.write(CCP, CONTROL, BERT) == ACCESS_DENIED
    assert camera.written == []
    assert camera.write(CCP, 0, request_id=2) == 0
    assert camera.releases == 1
    assert camera.write(COUNTER, 1, request_id=3) == ACCESS_DENIED
    assert camera.write(CCP, CONTROL, BERT) == 0


def test_exclusive_access_lets_others_see_only_that_it_is_taken(camera: Camera) -> None:
    assert camera.write(CCP, EXCLUSIVE, request_id=2) == 0
    assert camera.read(COUNTER, BERT)[0] == ACCESS_DENIED
    assert camera.read(CCP, BERT) == (0, struct.pack(">I", EXCLUSIVE))
    assert camera.ask(DISCOVERY, peer=BERT)[0] == 0


def test_control_is_lost_after_three_silent_seconds(camera: Camera) -> None:
    camera.now_s += 2.9
    assert camera.read(CCP) == (0, struct.pack(">I", CONTROL))  # a sign of life
    camera.now_s += 2.9
    assert camera.write(CCP, CONTROL, BERT) == ACCESS_DENIED  # which keeps nothing alive
    camera.now_s += 0.2
    camera.channel.expire(camera.now_s)
    assert camera.releases == 1
    assert camera.read(CCP) == (0, bytes(4))
    assert camera.write(CCP, CONTROL, BERT) == 0


@pytest.mark.wire
def test_a_long_heartbeat_timeout_does_not_outlast_a_restart() -> None:
    address = loopback_address()
    with gige_camera(address) as camera, GvcpClient(address) as client:
        client.write(CCP, CONTROL)
        assert client.write(HEARTBEAT_TIMEOUT, 600_000) == 0
        camera.execute("DeviceReset")
        assert client.read(HEARTBEAT_TIMEOUT) == 3000


def test_resend_is_asked_of_the_controlling_host_from_any_port(camera: Camera) -> None:
    request = struct.pack(">HHII", 0, 5, 2, 4)
    assert camera.channel.answer(command(PACKETRESEND, request), (ANNE[0], 6000), camera.now_s) is None
    assert camera.channel.answer(command(PACKETRESEND, request), BERT, camera.now_s) is None
    assert camera.resends == [Resend(0, 5, 2, 4)]


ROBOT, OTHER = ("10.0.0.1", 5000), ("10.0.0.2", 5000)
KEY, GROUP, MASK = 0xCAFE, 7, 0b0110
ACK, SCHEDULED = 0x01, 0x80
NO_REF_TIME, OVERFLOW, ACTION_LATE, ERROR = 0x8013, 0x8015, 0x8016, 0x8FFF
EXTENDED_STATUS = 0x40000


@dataclass
class ActionCamera:
    device: Device
    privilege: ControlPrivilege = field(default_factory=ControlPrivilege)
    request_id: int = 0

    def __post_init__(self) -> None:
        self.actions = ActionChannel(self.device, self.privilege)
        self.channel = ControlChannel(RegisterMap([]), self.privilege, lambda _: None, lambda: None, self.actions.act)
        self.privilege.request(ROBOT, 2, 0.0)
        for name, value in (
            ("ActionDeviceKey", KEY),
            ("ActionGroupKey", GROUP),
            ("ActionGroupMask", MASK),
            ("TriggerMode", "On"),
            ("TriggerSource", "Action1"),
        ):
            self.device.features.set(name, value)
        self.device.execute("AcquisitionStart")

    def send(self, payload: bytes, flags: int = ACK) -> int | None:
        """The status of the acknowledgement; None when there is none."""
        self.request_id += 1
        return self.repeat(payload, flags)

    def repeat(self, payload: bytes, flags: int = ACK) -> int | None:
        answer = self.channel.answer(command(ACTION, payload, self.request_id, flags), OTHER, 0.0)
        if answer is None:
            return None
        status, ack, request_id, rest = parse_ack(answer)
        assert (ack, request_id, rest) == (ACTION + 1, self.request_id, b"")
        return status

    def schedule(self, time_ns: int) -> int | None:
        return self.send(struct.pack(">IIIQ", KEY, GROUP, MASK, time_ns), ACK | SCHEDULED)

    @property
    def taken(self) -> int:
        """How many actions came to the trigger: those during exposure or readout are dropped."""
        return self.device.counters.exposures + self.device.counters.dropped


@pytest.fixture
def acting() -> Iterator[ActionCamera]:
    with device(ptp_clock=0x0200_00FF_FE00_0001) as acting:
        yield ActionCamera(acting)


def keys(device_key: int = KEY, group_key: int = GROUP, group_mask: int = MASK) -> bytes:
    return struct.pack(">III", device_key, group_key, group_mask)


def test_an_action_with_the_right_keys_is_carried_out_whoever_sends_it(acting: ActionCamera) -> None:
    assert acting.send(keys()) == 0
    assert acting.taken == 1
    assert acting.send(keys(group_mask=0b1100)) == 0  # one common bit is enough
    assert acting.send(keys(), flags=0) is None  # nobody asks for an answer
    assert acting.taken == 3
    assert acting.repeat(keys(), flags=0) is None  # it acts once
    assert acting.taken == 3


@pytest.mark.parametrize("payload", [keys(device_key=1), keys(group_key=1), keys(group_mask=0b1001)])
def test_an_action_for_others_is_ignored_without_an_answer(acting: ActionCamera, payload: bytes) -> None:
    assert acting.send(payload) is None
    assert acting.taken == 0


def test_without_a_client_only_the_unconditional_mode_acts(acting: ActionCamera) -> None:
    acting.privilege.drop()
    assert acting.send(keys()) is None
    acting.device.features.set("ActionUnconditionalMode", "On")
    assert acting.send(keys()) == 0
    assert acting.taken == 1


def test_an_action_between_a_write_and_its_repetition_does_not_let_it_happen_twice(acting: ActionCamera) -> None:
    written: list[int] = []
    channel = ControlChannel(
        RegisterMap([unsigned(0, lambda: 0, written.append)]),
        acting.privilege,
        lambda _: None,
        lambda: None,
        acting.actions.act,
    )
    write, action = command(WRITEREG, struct.pack(">II", 0, 5), 1), command(ACTION, keys(), 1)
    for datagram, peer in ((write, ROBOT), (action, OTHER), (write, ROBOT), (action, OTHER)):
        assert channel.answer(datagram, peer, 0.0) is not None
    assert (written, acting.taken) == ([5], 1)


def test_a_command_cut_short_is_refused(acting: ActionCamera) -> None:
    assert acting.send(keys()[:-1]) == INVALID_HEADER
    assert acting.send(keys(), ACK | SCHEDULED) == INVALID_HEADER
    assert acting.taken == 0


def test_a_scheduled_action_needs_a_time_that_a_master_has_set(acting: ActionCamera) -> None:
    assert acting.schedule(2**63) == NO_REF_TIME
    assert acting.device.ptp is not None
    acting.device.ptp.set_by_master = True
    assert acting.schedule(2**63) == 0
    assert acting.taken == 0


def test_a_late_action_is_carried_out_at_once_and_too_many_are_refused(acting: ActionCamera) -> None:
    assert acting.device.ptp is not None
    acting.device.ptp.set_by_master = True
    assert acting.schedule(acting.device.now_ns()) == ACTION_LATE
    assert acting.taken == 1
    assert [acting.schedule(2**62 + number) for number in range(11)] == [0] * 10 + [OVERFLOW]
    acting.actions.configuration &= ~EXTENDED_STATUS
    assert acting.schedule(acting.device.now_ns()) == ERROR
    assert acting.schedule(2**62) == ERROR
    acting.actions.reset()
    assert acting.schedule(2**62) == OVERFLOW


def test_lost_actions_are_neither_answered_nor_carried_out(acting: ActionCamera) -> None:
    acting.device.faults.add(FaultOrder(Fault.LOSE_ACTIONS, None, 1))
    assert acting.send(keys()) is None
    assert acting.taken == 0
    assert acting.send(keys()) == 0
    assert acting.taken == 1
