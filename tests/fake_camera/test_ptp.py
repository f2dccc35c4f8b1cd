"""PTP: clocks, messages, and cameras' clocks that follow a master in virtual time."""

from __future__ import annotations

import heapq
import itertools
import math
import random
import struct
from collections.abc import Callable, Sequence
from typing import Protocol

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fake_camera.ptp.clock import Clock
from fake_camera.ptp.master import Master
from fake_camera.ptp.messages import Grandmaster, Message, MessageType, PortIdentity, clock_identity
from fake_camera.ptp.servo import LOCKED_NS, STEP_NS, Servo
from fake_camera.ptp.slave import PortState, Slave

S = 1_000_000_000
EPOCH = 1_700_000_000 * S
ppm = st.floats(-500, 500)


def test_it_drifts_from_where_it_was_set() -> None:
    clock = Clock(3 * S, EPOCH, 40.0)
    assert clock.time_ns(3 * S) == EPOCH
    assert clock.time_ns(1003 * S) - EPOCH == 1000 * S + 40_000_000
    clock.set(7, 1003 * S)
    assert clock.time_ns(1004 * S) == 7 + S + 40_000


@given(ppm, ppm, st.integers(0, 10**14), st.integers(0, 10**14))
def test_the_host_time_is_found_for_the_time_it_shows(drift: float, steered: float, at_ns: int, host_ns: int) -> None:
    clock = Clock(0, EPOCH, drift)
    clock.steer(steered, at_ns)
    assert abs(clock.host_ns(clock.time_ns(host_ns)) - host_ns) <= 2


@given(ppm, ppm, st.integers(0, 10**14))
def test_steering_and_warmth_change_the_rate_but_not_the_time(drift: float, steered: float, at_ns: int) -> None:
    clock = Clock(0, EPOCH, drift)
    before_ns = clock.time_ns(at_ns)
    clock.steer(steered, at_ns)
    clock.drift(-drift, at_ns)
    assert clock.time_ns(at_ns) == before_ns
    gained_ns = clock.time_ns(at_ns + S) - before_ns - S
    assert abs(gained_ns - (steered - drift) * 1e3) <= 500  # parts per million of each other


u8, u16, u64 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 64))
times = st.integers(0, 2**63 - 1)
identities = st.builds(PortIdentity, u64, u16)
grandmasters = st.builds(Grandmaster, u64, u8, u8, u8, u16, u8, u16, u8, st.integers(-(2**15), 2**15 - 1))


@st.composite
def messages(draw: st.DrawFn) -> Message:
    kind = draw(st.sampled_from(MessageType))
    return Message(
        kind,
        draw(identities),
        draw(u16),
        draw(times),
        draw(u8),
        draw(st.booleans()),
        draw(st.integers(-(2**63), 2**63 - 1)),
        draw(st.integers(-128, 127)),
        draw(identities) if kind is MessageType.DELAY_RESP else None,
        draw(grandmasters) if kind is MessageType.ANNOUNCE else None,
    )


@given(messages(), st.binary(max_size=20))
def test_a_message_is_read_as_it_was_written_whatever_follows_it(message: Message, suffix: bytes) -> None:
    assert Message.from_bytes(message.to_bytes() + suffix) == message


@given(messages(), st.data())
def test_a_message_cut_short_is_none(message: Message, data: st.DataObject) -> None:
    datagram = message.to_bytes()
    assert Message.from_bytes(datagram[: data.draw(st.integers(0, len(datagram) - 1))]) is None


@given(st.binary(max_size=80) | st.binary(min_size=60, max_size=80).map(lambda data: b"\x0b\x02\0\x40" + data))
def test_any_bytes_are_a_message_or_none(datagram: bytes) -> None:
    message = Message.from_bytes(datagram)
    assert message is None or Message.from_bytes(message.to_bytes()) == message


def test_the_bytes_of_a_delay_resp_are_those_of_the_standard() -> None:
    message = Message(
        MessageType.DELAY_RESP,
        PortIdentity(0x0102030405060708, 9),
        0x0A0B,
        (0x000100000002 * 10**9) + 3,
        4,
        correction=5 << 16,
        log_interval=-3,
        requester=PortIdentity(0x1112131415161718, 0x191A),
    )
    assert message.to_bytes() == (
        bytes.fromhex("0902 0036 04 00 0000 0000000000050000 00000000 0102030405060708 0009 0a0b 03 fd")
        + bytes.fromhex("0001 00000002 00000003")
        + bytes.fromhex("1112131415161718 191a")
    )
    assert message.correction_ns == 5


def test_other_versions_types_and_impossible_times_are_none() -> None:
    datagram = Message(MessageType.SYNC, PortIdentity(1), 2, two_step=True).to_bytes()
    assert datagram[:2] == b"\0\2"
    assert datagram[6:8] == b"\2\0"
    for at, wrong in ((0, b"\x0c"), (1, b"\1"), (40, struct.pack(">I", 10**9)), (34, b"\xff")):
        assert Message.from_bytes(datagram[:at] + wrong + datagram[at + len(wrong) :]) is None


def test_a_clock_identity_has_fffe_in_the_middle_of_the_mac_address() -> None:
    assert clock_identity(0x0200_1122_3344) == 0x0200_11FF_FE22_3344


TICK_NS = S // 8


class Station(Protocol):
    """A master or a slave."""

    identity: PortIdentity

    def poll(self, host_ns: int) -> list[Message]: ...
    def receive(self, message: Message, host_ns: int) -> None: ...
    def sent(self, message: Message, host_ns: int) -> None: ...


class Network:
    """Carries messages as bytes from each station to all others, each after a delay of its own."""

    def __init__(self, stations: Sequence[Station], delay_ns: Callable[[], int], tick_ns: int = TICK_NS) -> None:
        self.stations = list(stations)
        self.now_ns = 0
        self._delay_ns = delay_ns
        self._tick_ns = tick_ns
        self._under_way: list[tuple[int, int, Station, bytes]] = []
        self._order = itertools.count()

    def run_until(self, end_ns: int) -> None:
        while self.now_ns < end_ns:
            for station in self.stations:
                self._send(station, self.now_ns)
            self.now_ns += self._tick_ns
            self._deliver_until(self.now_ns)

    def _deliver_until(self, end_ns: int) -> None:
        while self._under_way and self._under_way[0][0] < end_ns:
            at_ns, _, station, datagram = heapq.heappop(self._under_way)
            if station in self.stations:
                message = Message.from_bytes(datagram)
                assert message is not None
                station.receive(message, at_ns)
                self._send(station, at_ns)

    def _send(self, station: Station, at_ns: int) -> None:
        while messages := station.poll(at_ns):
            for message in messages:
                datagram = message.to_bytes()
                for other in self.stations:
                    if other is not station:
                        arrival_ns = at_ns + self._delay_ns()
                        heapq.heappush(self._under_way, (arrival_ns, next(self._order), other, datagram))
                if message.type.is_event:
                    station.sent(message, at_ns)


DRIFTS_PPM = (40.0, -60.0)
MASTER = PortIdentity(0xA)


def quiet() -> int:
    return 20_000


def disturbed(seed: int) -> Callable[[], int]:
    """Delays of some 20 us, and of up to 20 ms for one message in a hundred."""
    numbers = random.Random(seed)
    return lambda: round(numbers.gammavariate(2, 10_000)) + (numbers.random() < 0.01) * numbers.randrange(20_000_000)


class Rig:
    """A master and two cameras, switched on at different times."""

    def __init__(self, delay_ns: Callable[[], int] = quiet, log_sync_interval: int = -3) -> None:
        self.jumped_ns = 0
        self.enabled = True
        self.clocks = [Clock(0, 5 * S, DRIFTS_PPM[0]), Clock(0, 7 * S, DRIFTS_PPM[1])]
        self.slaves = [
            Slave(clock, PortIdentity(number), lambda: self.enabled) for number, clock in enumerate(self.clocks, 1)
        ]
        self.master = Master(MASTER, self.true_ns, log_sync_interval)
        self.network = Network([self.master, *self.slaves], delay_ns, round(2.0**log_sync_interval * S))

    def true_ns(self, host_ns: int) -> int:
        return EPOCH + host_ns + self.jumped_ns

    def run(self, seconds: float) -> None:
        self.network.run_until(self.network.now_ns + round(seconds * S))

    @property
    def states(self) -> set[PortState]:
        return {slave.state for slave in self.slaves}

    def offsets_ns(self) -> list[int]:
        now_ns = self.network.now_ns
        return [clock.time_ns(now_ns) - self.true_ns(now_ns) for clock in self.clocks]


def test_slaves_are_locked_within_seconds() -> None:
    rig = Rig()
    rig.run(5.0)
    assert rig.states == {PortState.Slave}
    assert max(map(abs, rig.offsets_ns())) < 1000
    assert rig.slaves[0].data_set().locked
    assert rig.slaves[0].data_set().parent == rig.slaves[0].data_set().grandmaster == MASTER.clock
    assert abs(rig.slaves[0].data_set().offset_ns) < 1000


def test_two_cameras_agree_for_ten_hours_while_their_crystals_warm_and_cool() -> None:
    rig = Rig(disturbed(seed=1), log_sync_interval=2)
    rig.run(120.0)
    worst_ns = 0
    while rig.network.now_ns < 36_000 * S:
        rig.run(10.0)
        for clock, ppm in zip(rig.clocks, DRIFTS_PPM, strict=True):
            clock.drift(ppm + 5.0 * math.sin(rig.network.now_ns * 1e-9 / 600), rig.network.now_ns)
        left_ns, right_ns = rig.offsets_ns()
        worst_ns = max(worst_ns, abs(left_ns), abs(right_ns), abs(left_ns - right_ns))
        assert rig.states == {PortState.Slave}
    assert worst_ns < 150_000


def test_without_master_they_listen_and_part_at_the_rate_of_their_crystals() -> None:
    rig = Rig()
    rig.network.stations[0] = Master(MASTER, rig.true_ns, domain=1)  # of another domain, which is not heard
    rig.run(5.0)
    assert rig.states == {PortState.Listening}
    rig.network.stations[0] = rig.master
    rig.run(5.0)
    rig.network.stations.remove(rig.master)
    rig.run(1.0)
    assert rig.states == {PortState.Slave}
    rig.run(3.0)
    assert rig.states == {PortState.Listening}
    data_set = rig.slaves[0].data_set()
    assert not data_set.locked
    assert data_set.parent == data_set.grandmaster == rig.slaves[0].identity.clock
    left_ns, right_ns = rig.offsets_ns()
    rig.run(100.0)
    later_left_ns, later_right_ns = rig.offsets_ns()
    assert later_left_ns - left_ns == pytest.approx(4_000_000, rel=1e-3)
    assert later_right_ns - right_ns == pytest.approx(-6_000_000, rel=1e-3)
    assert rig.slaves[0].set_by_master

    rig.network.stations.append(rig.master)
    rig.run(5.0)
    assert rig.states == {PortState.Slave}
    assert max(map(abs, rig.offsets_ns())) < LOCKED_NS


def test_of_two_masters_that_announce_in_turn_the_first_is_followed_until_it_is_gone() -> None:
    rig = Rig()
    other = PortIdentity(0xB)
    rig.network.stations.append(Master(other, rig.true_ns))
    rig.run(5.0)
    assert rig.states == {PortState.Slave}
    assert max(map(abs, rig.offsets_ns())) < 1000
    assert {slave.data_set().parent for slave in rig.slaves} == {MASTER.clock}
    rig.network.stations.remove(rig.master)
    rig.run(8.0)
    assert rig.states == {PortState.Slave}
    assert {slave.data_set().parent for slave in rig.slaves} == {other.clock}


@pytest.mark.parametrize("jump_ns", [10 * S, -10 * S, 30_000_000])
def test_a_jump_of_the_master_is_followed_after_losing_the_lock(jump_ns: int) -> None:
    rig = Rig()
    rig.run(5.0)
    rig.jumped_ns += jump_ns
    rig.run(1.0)
    assert rig.states == {PortState.Uncalibrated}
    rig.run(4.0)
    assert rig.states == {PortState.Slave}
    assert max(map(abs, rig.offsets_ns())) < 1000


def test_a_master_that_is_announced_but_not_heard_is_no_time() -> None:
    rig = Rig()
    rig.run(5.0)
    now_ns, states = rig.network.now_ns, []
    for _ in range(24):
        now_ns += S // 8
        rig.slaves[0].poll(now_ns)
        for message in rig.master.poll(now_ns):
            if message.type is MessageType.ANNOUNCE:
                rig.slaves[0].receive(message, now_ns)
        states.append(rig.slaves[0].state)
    assert set(states[:8]) == {PortState.Slave}
    assert states[-1] is PortState.Uncalibrated


def test_disabled_it_takes_no_part_and_keeps_its_time() -> None:
    rig = Rig()
    rig.enabled = False
    rig.run(5.0)
    assert rig.states == {PortState.Disabled}
    assert not rig.slaves[0].set_by_master
    assert rig.clocks[0].time_ns(5 * S) == 10 * S + 200_000
    rig.enabled = True
    assert rig.states == {PortState.Initializing}
    rig.run(0.2)
    assert rig.states == {PortState.Listening}
    rig.run(5.0)
    rig.enabled = False
    rig.run(1.0)
    assert rig.slaves[0].data_set().state is PortState.Disabled
    assert abs(rig.offsets_ns()[0]) < 100_000


def test_what_switches_correct_for_is_taken_off() -> None:
    clock = Clock(0, 0)
    slave = Slave(clock, PortIdentity(1), lambda: True)
    slave.poll(0)
    for number in range(2):
        slave.receive(Message(MessageType.ANNOUNCE, MASTER, number, grandmaster=Grandmaster(MASTER.clock)), 0)
    for number in range(3):
        at_ns = number * S // 2
        sync = Message(MessageType.SYNC, MASTER, number, two_step=True, correction=600 << 16)
        slave.receive(sync, at_ns + 1700)
        follow_up = Message(MessageType.FOLLOW_UP, MASTER, number, EPOCH + at_ns, correction=100 << 16)
        slave.receive(follow_up, at_ns + 1700)
        (request,) = slave.poll(at_ns + 1700)
        slave.sent(request, at_ns + 2000)
        answer = Message(
            MessageType.DELAY_RESP,
            MASTER,
            request.sequence_id,
            EPOCH + at_ns + 3300,
            correction=300 << 16,
            requester=slave.identity,
        )
        slave.receive(answer, at_ns + 5000)
    assert clock.time_ns(10 * S) == EPOCH + 10 * S


@settings(max_examples=50)
@given(st.lists(messages(), max_size=30))
def test_no_sequence_of_messages_breaks_a_slave_or_a_master(heard: list[Message]) -> None:
    rig = Rig()
    for number, message in enumerate(heard):
        for station in (rig.master, rig.slaves[0]):
            station.receive(message, number * S // 10)
            for answer in station.poll(number * S // 10):
                assert Message.from_bytes(answer.to_bytes()) == answer


@given(st.lists(st.tuples(st.integers(-(10**18), 10**18), st.integers(-(10**9), 10**9)), max_size=60))
def test_whatever_it_measures_the_servo_steers_within_bounds(samples: list[tuple[int, int]]) -> None:
    servo = Servo()
    for number, (offset_ns, delay_ns) in enumerate(samples):
        step_ns = servo.sample(offset_ns, delay_ns, number / 8)
        assert step_ns is None or abs(step_ns) <= abs(offset_ns)
        assert abs(servo.ppm) <= 500


def test_a_locked_servo_leaves_out_single_outliers() -> None:
    servo = Servo()
    for number in range(40):
        servo.sample(0, 20_000, number / 8)
    assert servo.locked
    assert servo.sample(0, 500_000, 5.0) is None  # slow
    assert servo.sample(3 * STEP_NS, 20_000, 5.1) is None  # far
    assert servo.sample(0, 20_000, 5.2) == 0
    assert servo.locked
    servo.sample(2 * LOCKED_NS, 20_000, 5.3)
    assert servo.locked
    for number in range(3):
        servo.sample(2 * LOCKED_NS, 20_000, 5.4 + number / 8)
    assert not servo.locked
