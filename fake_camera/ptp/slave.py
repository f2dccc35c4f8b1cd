"""The PTP port of a camera: an ordinary clock that is only ever a slave; a state machine without sockets or clock."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

from fake_camera.ptp.clock import Clock
from fake_camera.ptp.messages import Message, MessageType, PortIdentity
from fake_camera.ptp.servo import Servo

_NS_PER_S = 1_000_000_000
_ANNOUNCES_TO_QUALIFY = 2
_ANNOUNCE_TIMEOUT = 3
"""A master is gone when so many intervals of its Announce bring none."""
_SYNC_TIMEOUT = 6
"""A slave whose Sync brings nothing for so many intervals does not know the time any more."""
_SHORTEST_TIMEOUT_NS = 2 * _NS_PER_S
"""Neither is less than this, as a busy host may stop a process for a while."""
_LONGEST_LOG_INTERVAL = 6  # 0x7F means that there is no interval


class PortState(IntEnum):
    """States of a PTP port, with the numbers of IEEE 1588 and the names of SFNC; not all occur in a slave."""

    Initializing = 1
    Faulty = 2
    Disabled = 3
    Listening = 4
    PreMaster = 5
    Master = 6
    Passive = 7
    Uncalibrated = 8
    Slave = 9


@dataclass(frozen=True, slots=True)
class DataSet:
    """What a port tells of itself; without a master the clock is its own parent and grandmaster."""

    state: PortState
    locked: bool
    offset_ns: int
    parent: int
    grandmaster: int


@dataclass(slots=True)
class _Exchange:
    """The four times of one Sync and the Delay_Req after it, each on the clock of who sent or received it."""

    sync_id: int | None = None
    sent_ns: int | None = None
    arrived_ns: int | None = None
    correction_ns: float = 0.0
    request_id: int | None = None
    request_ns: int | None = None


@dataclass(slots=True)
class _Parent:
    """The master that is followed, and what is known of it; `..._ns` are times of the host."""

    source: PortIdentity
    grandmaster: int
    announced_ns: int
    sampled_ns: int
    announce_timeout_ns: int = _SHORTEST_TIMEOUT_NS
    sync_timeout_ns: int = _SHORTEST_TIMEOUT_NS
    servo: Servo = field(default_factory=Servo)
    exchange: _Exchange = field(default_factory=_Exchange)


class Slave:
    """Follows the first master that announces itself, and another one only when that is gone. Thread-safe.

    Times called `host_ns` are CLOCK_MONOTONIC. `enabled` is asked whether the port takes part at all. Without a master,
    or disabled, the clock runs as its crystal does.

    Attributes
    ----------
    identity
        Of its port.
    set_by_master
        Whether a master has set the clock since the port was enabled.
    """

    def __init__(self, clock: Clock, identity: PortIdentity, enabled: Callable[[], bool], domain: int = 0) -> None:
        self.identity = identity
        self.set_by_master = False
        self._clock = clock
        self._enabled = enabled
        self._domain = domain
        self._lock = threading.RLock()
        self._running = False
        self._parent: _Parent | None = None
        self._announces = Counter[PortIdentity]()  # of each master, while none is followed
        self._request_id = 0
        self._outbox: list[Message] = []

    @property
    def state(self) -> PortState:
        """Its state now."""
        with self._lock:
            if not self._enabled():
                return PortState.Disabled
            if not self._running:
                return PortState.Initializing
            if self._parent is None:
                return PortState.Listening
            return PortState.Slave if self._parent.servo.locked else PortState.Uncalibrated

    def data_set(self) -> DataSet:
        """What it tells of itself now."""
        with self._lock:
            state, parent = self.state, self._parent
            if parent is None or state <= PortState.Disabled:
                return DataSet(state, False, 0, self.identity.clock, self.identity.clock)
            servo = parent.servo
            return DataSet(state, servo.locked, servo.offset_ns, parent.source.clock, parent.grandmaster)

    def poll(self, host_ns: int) -> list[Message]:
        """Let time pass; returns what is to be sent now."""
        with self._lock:
            if not self._enabled():
                if self._running:
                    self._forget_master(host_ns)
                self._running = self.set_by_master = False
                return []
            self._running = True
            parent = self._parent
            if parent is not None and host_ns > parent.announced_ns + parent.announce_timeout_ns:
                self._forget_master(host_ns)
            elif parent is not None and host_ns > parent.sampled_ns + parent.sync_timeout_ns:
                parent.servo, parent.sampled_ns = Servo(), host_ns  # it is still announced, but its time not heard
            sent, self._outbox = self._outbox, []
            return sent

    def receive(self, message: Message, host_ns: int) -> None:
        """Take a message that arrived at `host_ns`."""
        with self._lock:
            if self.state <= PortState.Disabled or message.domain != self._domain:
                return
            if message.type is MessageType.ANNOUNCE:
                self._on_announce(message, host_ns)
            elif self._parent is not None and message.source == self._parent.source:
                self._on_time(self._parent, message, host_ns)

    def sent(self, message: Message, host_ns: int) -> None:
        """A Delay_Req of `poll` left at `host_ns`."""
        with self._lock:
            if self._parent is not None and message.sequence_id == self._parent.exchange.request_id:
                self._parent.exchange.request_ns = self._clock.time_ns(host_ns)

    def _on_announce(self, message: Message, host_ns: int) -> None:
        assert message.grandmaster is not None
        if self._parent is None:
            self._announces[message.source] += 1
            if self._announces[message.source] < _ANNOUNCES_TO_QUALIFY:
                return
            self._parent = _Parent(message.source, message.grandmaster.clock, host_ns, host_ns)
        if message.source == self._parent.source:
            self._parent.grandmaster = message.grandmaster.clock
            self._parent.announced_ns = host_ns
            self._parent.announce_timeout_ns = _timeout_ns(_ANNOUNCE_TIMEOUT, message.log_interval)

    def _on_time(self, parent: _Parent, message: Message, host_ns: int) -> None:
        exchange = parent.exchange
        if message.type is MessageType.DELAY_RESP:
            if message.requester == self.identity and message.sequence_id == exchange.request_id:
                self._on_answer(parent, message, host_ns)
            return
        if message.type not in (MessageType.SYNC, MessageType.FOLLOW_UP):
            return
        if message.sequence_id != exchange.sync_id:  # the two may overtake each other
            exchange = parent.exchange = _Exchange(message.sequence_id)
        exchange.correction_ns += message.correction_ns
        if message.type is MessageType.SYNC:
            exchange.arrived_ns = self._clock.time_ns(host_ns)
            parent.sync_timeout_ns = _timeout_ns(_SYNC_TIMEOUT, message.log_interval)
        if not message.two_step:  # a Follow_Up, or a Sync without one
            exchange.sent_ns = message.time_ns
        if exchange.sent_ns is not None and exchange.arrived_ns is not None and exchange.request_id is None:
            self._ask(exchange)

    def _ask(self, exchange: _Exchange) -> None:
        """Ask the master how long a message takes the other way."""
        self._request_id = (self._request_id + 1) & 0xFFFF
        exchange.request_id = self._request_id
        self._outbox.append(Message(MessageType.DELAY_REQ, self.identity, self._request_id, domain=self._domain))

    def _on_answer(self, parent: _Parent, message: Message, host_ns: int) -> None:
        exchange, parent.exchange = parent.exchange, _Exchange()
        if exchange.sent_ns is None or exchange.arrived_ns is None or exchange.request_ns is None:
            return
        to_slave_ns = exchange.arrived_ns - exchange.sent_ns - round(exchange.correction_ns)
        to_master_ns = message.time_ns - exchange.request_ns - round(message.correction_ns)
        offset_ns, delay_ns = (to_slave_ns - to_master_ns) // 2, (to_slave_ns + to_master_ns) // 2
        step_ns = parent.servo.sample(offset_ns, delay_ns, host_ns * 1e-9)
        if step_ns is None:
            return
        self._clock.set(self._clock.time_ns(host_ns) + step_ns, host_ns)
        self._clock.steer(parent.servo.ppm, host_ns)
        self.set_by_master = True
        parent.sampled_ns = host_ns

    def _forget_master(self, host_ns: int) -> None:
        self._parent = None
        self._announces.clear()
        self._outbox = []
        self._clock.steer(0.0, host_ns)


def _timeout_ns(intervals: int, log_interval: int) -> int:
    """How long to wait for a message that comes every 2**log_interval seconds, if that is plausible."""
    interval_s = 2.0**log_interval if log_interval <= _LONGEST_LOG_INTERVAL else 0.0
    return max(round(intervals * interval_s * _NS_PER_S), _SHORTEST_TIMEOUT_NS)
