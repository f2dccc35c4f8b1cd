"""A master and slaves in virtual time: messages arrive after delays that the test chooses."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Sequence
from typing import Protocol

from fake_camera.ptp.messages import Message, PortIdentity

S = 1_000_000_000
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
