"""The messages of IEEE 1588-2008 (PTPv2) that end-to-end synchronisation needs, as bytes over UDP."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

GROUP = "224.0.1.129"
"""The multicast address of all PTP messages but those on peer delays."""

_VERSION = 2
_HEADER = struct.Struct(">BBHBxHq4xQHHBb")
_TIMESTAMP = struct.Struct(">HII")
_PORT = struct.Struct(">QH")
_GRANDMASTER = struct.Struct(">hxBBBHBQHB")
_TWO_STEP = 0x0200
_CORRECTIONS_PER_NS = 1 << 16
_NS_PER_S = 1_000_000_000
_LATEST_NS = (1 << 63) - 1  # in the year 2262; cameras' stamps have 64 bits


class MessageType(IntEnum):
    """Those that are known here; the first two are event messages, whose times of sending and arrival count."""

    SYNC = 0x0
    DELAY_REQ = 0x1
    FOLLOW_UP = 0x8
    DELAY_RESP = 0x9
    ANNOUNCE = 0xB

    @property
    def is_event(self) -> bool:
        """Whether it goes to the event port."""
        return self in (MessageType.SYNC, MessageType.DELAY_REQ)


_CONTROL = {MessageType.SYNC: 0, MessageType.DELAY_REQ: 1, MessageType.FOLLOW_UP: 2, MessageType.DELAY_RESP: 3}
_CONTROL_OTHERS = 5


@dataclass(frozen=True, slots=True)
class PortIdentity:
    """A clock's EUI-64, and the number of its port."""

    clock: int
    port: int = 1


@dataclass(frozen=True, slots=True)
class Grandmaster:
    """What an Announce says of the clock that all others follow.

    The defaults are those of a clock that is synchronised to nothing and of unknown accuracy.
    """

    clock: int
    priority1: int = 128
    clock_class: int = 248
    accuracy: int = 0xFE
    variance: int = 0xFFFF
    priority2: int = 128
    steps_removed: int = 0
    time_source: int = 0xA0
    utc_offset_s: int = 0


@dataclass(frozen=True, slots=True)
class Message:
    """One message.

    Attributes
    ----------
    time_ns
        Its timestamp: when a Sync left (0 in the first of two steps), or a Delay_Req arrived.
    correction
        The correction field, ns / 65536: what the message spent in switches that know PTP.
    log_interval
        Binary logarithm of the seconds between messages of this type.
    requester
        Whom a Delay_Resp answers.
    grandmaster
        In an Announce.
    """

    type: MessageType
    source: PortIdentity
    sequence_id: int
    time_ns: int = 0
    domain: int = 0
    two_step: bool = False
    correction: int = 0
    log_interval: int = 0x7F
    requester: PortIdentity | None = None
    grandmaster: Grandmaster | None = None

    @property
    def correction_ns(self) -> float:
        """The correction field in ns."""
        return self.correction / _CORRECTIONS_PER_NS

    def to_bytes(self) -> bytes:
        """The datagram."""
        body = _TIMESTAMP.pack(*_split(self.time_ns))
        if self.requester is not None:
            body += _PORT.pack(self.requester.clock, self.requester.port)
        if self.grandmaster is not None:
            best = self.grandmaster
            body += _GRANDMASTER.pack(
                best.utc_offset_s,
                best.priority1,
                best.clock_class,
                best.accuracy,
                best.variance,
                best.priority2,
                best.clock,
                best.steps_removed,
                best.time_source,
            )
        header = _HEADER.pack(
            self.type,
            _VERSION,
            _HEADER.size + len(body),
            self.domain,
            _TWO_STEP if self.two_step else 0,
            self.correction,
            self.source.clock,
            self.source.port,
            self.sequence_id,
            _CONTROL.get(self.type, _CONTROL_OTHERS),
            self.log_interval,
        )
        return header + body

    @classmethod
    def from_bytes(cls, datagram: bytes) -> Message | None:
        """Parse a datagram; None when it is no PTPv2 message of a known type, and so to be ignored."""
        if len(datagram) < _HEADER.size + _TIMESTAMP.size:
            return None
        kind, version, length, domain, flags, correction, clock, port, sequence_id, _, interval = _HEADER.unpack_from(
            datagram
        )
        if kind not in _LENGTHS or version & 0xF != _VERSION or not _LENGTHS[kind] <= length <= len(datagram):
            return None
        seconds_high, seconds_low, ns = _TIMESTAMP.unpack_from(datagram, _HEADER.size)
        time_ns = ((seconds_high << 32) + seconds_low) * _NS_PER_S + ns
        if ns >= _NS_PER_S or time_ns > _LATEST_NS:
            return None
        type_ = MessageType(kind)
        return cls(
            type_,
            PortIdentity(clock, port),
            sequence_id,
            time_ns,
            domain,
            bool(flags & _TWO_STEP),
            correction,
            interval,
            _requester(datagram) if type_ is MessageType.DELAY_RESP else None,
            _grandmaster(datagram) if type_ is MessageType.ANNOUNCE else None,
        )


_BODY = _HEADER.size + _TIMESTAMP.size
_LENGTHS = dict.fromkeys(MessageType, _BODY) | {
    MessageType.DELAY_RESP: _BODY + _PORT.size,
    MessageType.ANNOUNCE: _BODY + _GRANDMASTER.size,
}


def clock_identity(mac_address: int) -> int:
    """The EUI-64 of a clock with a 48-bit MAC address."""
    return mac_address >> 24 << 40 | 0xFFFE << 24 | mac_address & 0xFFFFFF


def _requester(datagram: bytes) -> PortIdentity:
    return PortIdentity(*_PORT.unpack_from(datagram, _BODY))


def _grandmaster(datagram: bytes) -> Grandmaster:
    utc_offset_s, priority1, clock_class, accuracy, variance, priority2, clock, steps_removed, time_source = (
        _GRANDMASTER.unpack_from(datagram, _BODY)
    )
    return Grandmaster(
        clock, priority1, clock_class, accuracy, variance, priority2, steps_removed, time_source, utc_offset_s
    )


def _split(time_ns: int) -> tuple[int, int, int]:
    seconds, ns = divmod(time_ns, _NS_PER_S)
    return seconds >> 32, seconds & 0xFFFFFFFF, ns
