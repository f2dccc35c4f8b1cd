"""A PTP port on the network: UDP multicast, and a thread that passes messages between it and a slave or a master."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Protocol

from fake_camera.ptp.messages import GROUP, Message, PortIdentity

EVENT_PORT = 10319
"""The usual UDP port for event messages here, the next one for others. Those of IEEE 1588, 319 and 320, need root."""

_POLL_S = 0.02
_LONGEST_BYTES = 1500
_SO_TIMESTAMPNS = 35  # Python's socket module lacks it (asm-generic/socket.h)
_TIMESPEC = struct.Struct("=qq")
_LONGEST_QUEUED_NS = 10_000_000_000


class Station(Protocol):
    """A slave or a master; `host_ns` is CLOCK_MONOTONIC."""

    identity: PortIdentity

    def poll(self, host_ns: int) -> list[Message]:
        """Let time pass; returns what is to be sent now."""
        ...

    def receive(self, message: Message, host_ns: int) -> None:
        """Take a message that arrived at `host_ns`."""
        ...

    def sent(self, message: Message, host_ns: int) -> None:
        """An event message left at `host_ns`."""
        ...


class PtpPort:
    """Connects a station to the interface that has an IPv4 address; while not `present` it hears and says nothing.

    Times of arrival are the kernel's, times of sending are taken just before. OSError when a port cannot be used.
    """

    def __init__(
        self, station: Station, address: str, event_port: int, present: Callable[[], bool] = lambda: True
    ) -> None:
        self._station = station
        self._present = present
        with contextlib.ExitStack() as opened:
            self._event = opened.enter_context(_join(address, event_port))
            self._general = opened.enter_context(_join(address, event_port + 1))
            opened.pop_all()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"ptp {address}", daemon=True)

    def start(self) -> None:
        """Take part."""
        self._thread.start()

    def close(self) -> None:
        """Leave."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._event.close()
        self._general.close()

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            for udp in (self._event, self._general):
                selector.register(udp, selectors.EVENT_READ, udp)
            while not self._closing.is_set():
                for key, _events in selector.select(_POLL_S):
                    self._receive(key.data)
                self._send()

    def _receive(self, udp: socket.socket) -> None:
        datagram, ancillary, _flags, _peer = udp.recvmsg(_LONGEST_BYTES, socket.CMSG_SPACE(_TIMESPEC.size))
        message = Message.from_bytes(datagram)
        if message is not None and message.source.clock != self._station.identity.clock and self._present():
            self._station.receive(message, _arrival_ns(ancillary))

    def _send(self) -> None:
        while messages := self._station.poll(time.monotonic_ns()):
            for message in messages if self._present() else ():
                udp = self._event if message.type.is_event else self._general
                datagram = message.to_bytes()
                now_ns = time.monotonic_ns()
                with contextlib.suppress(OSError):  # no route, no room
                    udp.sendto(datagram, (GROUP, udp.getsockname()[1]))
                if message.type.is_event:
                    self._station.sent(message, now_ns)


def _join(address: str, port: int) -> socket.socket:
    """A socket that hears and says what is sent to the group at the interface with this address."""
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wrong = f"no network interface has the address {address}"
    try:
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # all cameras of a machine share it
        udp.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        interface = socket.inet_aton(address)
        udp.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
        udp.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + interface)
        wrong = f"UDP port {port} cannot be used, choose another one"
        udp.bind((GROUP, port))
    except OSError as error:
        udp.close()
        raise OSError(f"PTP: {wrong}: {error.strerror or error}") from error
    return udp


def _arrival_ns(ancillary: list[tuple[int, int, bytes]]) -> int:
    """CLOCK_MONOTONIC when the kernel received a datagram; now, if it does not say."""
    now_ns = time.monotonic_ns()
    for level, kind, data in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(data) == _TIMESPEC.size:
            seconds, ns = map(int, _TIMESPEC.unpack(data))
            queued_ns = time.time_ns() - seconds * 1_000_000_000 - ns
            if 0 <= queued_ns <= _LONGEST_QUEUED_NS:  # else that clock was set meanwhile
                return now_ns - queued_ns
    return now_ns
