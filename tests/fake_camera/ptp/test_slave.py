"""Cameras' clocks follow a master in virtual time, over a network that delays messages."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fake_camera.ptp.clock import Clock
from fake_camera.ptp.master import Master
from fake_camera.ptp.messages import Grandmaster, Message, MessageType, PortIdentity
from fake_camera.ptp.servo import LOCKED_NS, STEP_NS, Servo
from fake_camera.ptp.slave import PortState, Slave
from tests.fake_camera.ptp.test_messages import messages
from tests.fake_camera.ptp.virtual_network import Network, S

EPOCH = 1_700_000_000 * S
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
