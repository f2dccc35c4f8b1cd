"""ACTION on the control channel: who acts, and what is answered."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.registers import RegisterMap, unsigned
from fake_camera.gige.actions import ActionChannel
from fake_camera.gige.control_channel import ControlChannel
from tests.fake_camera.gige.gige_client import (
    ACTION,
    INVALID_HEADER,
    NOT_IMPLEMENTED,
    WRITEREG,
    command,
    device,
    parse_ack,
)

ROBOT, OTHER = ("10.0.0.1", 5000), ("10.0.0.2", 5000)
KEY, GROUP, MASK = 0xCAFE, 7, 0b0110
ACK, SCHEDULED = 0x01, 0x80
NO_REF_TIME, OVERFLOW, ACTION_LATE, ERROR = 0x8013, 0x8015, 0x8016, 0x8FFF
EXTENDED_STATUS = 0x40000


@dataclass
class Camera:
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
def camera() -> Iterator[Camera]:
    with device(ptp_clock=0x0200_00FF_FE00_0001) as camera:
        yield Camera(camera)


def keys(device_key: int = KEY, group_key: int = GROUP, group_mask: int = MASK) -> bytes:
    return struct.pack(">III", device_key, group_key, group_mask)


def test_an_action_with_the_right_keys_is_carried_out_whoever_sends_it(camera: Camera) -> None:
    assert camera.send(keys()) == 0
    assert camera.taken == 1
    assert camera.send(keys(group_mask=0b1100)) == 0  # one common bit is enough
    assert camera.send(keys(), flags=0) is None  # nobody asks for an answer
    assert camera.taken == 3
    assert camera.repeat(keys(), flags=0) is None  # it acts once
    assert camera.taken == 3


@pytest.mark.parametrize("payload", [keys(device_key=1), keys(group_key=1), keys(group_mask=0b1001)])
def test_an_action_for_others_is_ignored_without_an_answer(camera: Camera, payload: bytes) -> None:
    assert camera.send(payload) is None
    assert camera.taken == 0


def test_without_a_client_only_the_unconditional_mode_acts(camera: Camera) -> None:
    camera.privilege.drop()
    assert camera.send(keys()) is None
    camera.device.features.set("ActionUnconditionalMode", "On")
    assert camera.send(keys()) == 0
    assert camera.taken == 1


def test_an_action_between_a_write_and_its_repetition_does_not_let_it_happen_twice(camera: Camera) -> None:
    written: list[int] = []
    channel = ControlChannel(
        RegisterMap([unsigned(0, lambda: 0, written.append)]),
        camera.privilege,
        lambda _: None,
        lambda: None,
        camera.actions.act,
    )
    write, action = command(WRITEREG, struct.pack(">II", 0, 5), 1), command(ACTION, keys(), 1)
    for datagram, peer in ((write, ROBOT), (action, OTHER), (write, ROBOT), (action, OTHER)):
        assert channel.answer(datagram, peer, 0.0) is not None
    assert (written, camera.taken) == ([5], 1)


def test_a_command_cut_short_is_refused(camera: Camera) -> None:
    assert camera.send(keys()[:-1]) == INVALID_HEADER
    assert camera.send(keys(), ACK | SCHEDULED) == INVALID_HEADER
    assert camera.taken == 0


def test_a_scheduled_action_needs_a_time_that_a_master_has_set(camera: Camera) -> None:
    assert camera.schedule(2**63) == NO_REF_TIME
    assert camera.device.ptp is not None
    camera.device.ptp.set_by_master = True
    assert camera.schedule(2**63) == 0
    assert camera.taken == 0


def test_a_late_action_is_carried_out_at_once_and_too_many_are_refused(camera: Camera) -> None:
    assert camera.device.ptp is not None
    camera.device.ptp.set_by_master = True
    assert camera.schedule(camera.device.now_ns()) == ACTION_LATE
    assert camera.taken == 1
    assert [camera.schedule(2**62 + number) for number in range(11)] == [0] * 10 + [OVERFLOW]
    camera.actions.configuration &= ~EXTENDED_STATUS
    assert camera.schedule(camera.device.now_ns()) == ERROR
    assert camera.schedule(2**62) == ERROR
    camera.actions.reset()
    assert camera.schedule(2**62) == OVERFLOW


def test_lost_actions_are_neither_answered_nor_carried_out(camera: Camera) -> None:
    camera.device.faults.add(FaultOrder(Fault.LOSE_ACTIONS, None, 1))
    assert camera.send(keys()) is None
    assert camera.taken == 0
    assert camera.send(keys()) == 0
    assert camera.taken == 1


def test_a_camera_without_action_commands_does_not_know_them() -> None:
    channel = ControlChannel(RegisterMap([]), ControlPrivilege(), lambda _: None, lambda: None)
    answer = channel.answer(command(ACTION, keys()), ROBOT, 0.0)
    assert answer is not None
    assert parse_ack(answer)[0] == NOT_IMPLEMENTED
