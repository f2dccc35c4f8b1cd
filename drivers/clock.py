"""The camera's clock, mapped to the host's CLOCK_MONOTONIC."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from drivers.nodes import NodeMap

LATCH_TRIES = 5
"""A latch is as exact as half its round trip (0.1 ms on a quiet wire); the quickest of a few is kept."""
ARRIVAL_WINDOW = 600
"""Frames whose delays are compared without a latch: 10 s at 60 Hz, in which crystals of 50 ppm part by 0.5 ms."""
NANOSECONDS = 1_000_000_000


class DeviceClock(Protocol):
    """Maps device time to host time."""

    def host_time_ns(self, device_time_ns: int, arrival_time_ns: int) -> int:
        """Host time of a frame's time stamp, the frame having arrived at `arrival_time_ns`."""

    def latch(self) -> None:
        """Measure the mapping anew, where the camera can be asked."""


class LatchedClock:
    """Latches the camera's clock between two looks at the host's; the offset is that of their middle.

    Raises, from `latch` and at construction, `NodeError` and `CameraLostError`.
    """

    def __init__(
        self,
        nodes: NodeMap,
        command: str,
        value: str,
        tick_frequency_hz: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._nodes = nodes
        self._command = command
        self._value = value
        self._tick_frequency_hz = tick_frequency_hz
        self._now_ns = now_ns
        self._offset_ns = 0
        self.latch()

    def latch(self) -> None:
        """Measure the offset anew; a drift of some ppm moves it by microseconds a second."""
        _, self._offset_ns = min(self._sample() for _ in range(LATCH_TRIES))

    def _sample(self) -> tuple[int, int]:
        """Round trip and offset (both ns) of one latch."""
        before_ns = self._now_ns()
        self._nodes.execute(self._command)
        round_trip_ns = self._now_ns() - before_ns
        ticks = self._nodes.read_integer(self._value)
        device_ns = ticks * NANOSECONDS // self._tick_frequency_hz
        return round_trip_ns, before_ns + round_trip_ns // 2 - device_ns

    def host_time_ns(self, device_time_ns: int, arrival_time_ns: int) -> int:
        """Host time of a time stamp; the arrival is not needed."""
        return device_time_ns + self._offset_ns


class ArrivalClock:
    """For cameras without a latch: the quickest recent frame is taken to have arrived at once.

    Host times so mapped are late by the least delay from time stamp to arrival (exposure, readout and transfer).
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=ARRIVAL_WINDOW)

    def host_time_ns(self, device_time_ns: int, arrival_time_ns: int) -> int:
        """Host time of a frame's time stamp; never later than its arrival."""
        self._offsets_ns.append(arrival_time_ns - device_time_ns)
        return device_time_ns + min(self._offsets_ns)

    def latch(self) -> None:
        """Nothing to ask: frames alone tell."""


def find_clock(nodes: NodeMap) -> tuple[DeviceClock, tuple[str, ...]]:
    """The best clock mapping that this camera allows, and what it lacks in words."""
    if nodes.available("TimestampLatch") and nodes.available("TimestampLatchValue"):
        return LatchedClock(nodes, "TimestampLatch", "TimestampLatchValue", NANOSECONDS), ()
    if nodes.available("GevTimestampControlLatch") and nodes.available("GevTimestampValue"):
        tick_frequency_hz = NANOSECONDS
        if nodes.available("GevTimestampTickFrequency"):
            tick_frequency_hz = nodes.read_integer("GevTimestampTickFrequency") or NANOSECONDS
        return LatchedClock(nodes, "GevTimestampControlLatch", "GevTimestampValue", tick_frequency_hz), ()
    return ArrivalClock(), ("no time stamp latch: host times are inferred from arrival, late by the least delay",)
