"""Reading the camera's clock beside the host's CLOCK_MONOTONIC."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.genicam.nodes import NodeMap

LATCH_TRIES = 5
"""A latch is accurate to half its round trip (0.1 ms on a quiet wire); the quickest of a few is kept."""
NANOSECONDS = 1_000_000_000


class LatchedClock:
    """Latches the camera's clock between two readings of the host's; the offset refers to their midpoint."""

    def __init__(
        self,
        nodes: NodeMap,
        command: str,
        value: str,
        tick_frequency_hz: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.tick_ns = NANOSECONDS / tick_frequency_hz
        self._nodes = nodes
        self._command = command
        self._value = value
        self._tick_frequency_hz = tick_frequency_hz
        self._now_ns = now_ns

    def read(self) -> int:
        """Host time minus the camera's (ns); a drift of some ppm moves it by microseconds a second.

        Raises `NodeError` and `CameraLostError`.
        """
        _, offset_ns = min(self._sample() for _ in range(LATCH_TRIES))
        return offset_ns

    def _sample(self) -> tuple[int, int]:
        """Round trip and offset (both ns) of one latch."""
        before_ns = self._now_ns()
        self._nodes.execute(self._command)
        round_trip_ns = self._now_ns() - before_ns
        ticks = self._nodes.read_integer(self._value)
        device_ns = ticks * NANOSECONDS // self._tick_frequency_hz
        return round_trip_ns, before_ns + round_trip_ns // 2 - device_ns


def find_clock(nodes: NodeMap) -> tuple[LatchedClock | None, tuple[str, ...]]:
    """The clock that this camera lets the host read, if any, and its limitations in words."""
    if nodes.available("TimestampLatch") and nodes.available("TimestampLatchValue"):
        return LatchedClock(nodes, "TimestampLatch", "TimestampLatchValue", NANOSECONDS), ()
    if not (nodes.available("GevTimestampControlLatch") and nodes.available("GevTimestampValue")):
        return None, ("no time stamp latch: host times are inferred from arrival, late by readout and transfer",)
    tick_frequency_hz = NANOSECONDS
    if nodes.available("GevTimestampTickFrequency"):
        tick_frequency_hz = nodes.read_integer("GevTimestampTickFrequency") or NANOSECONDS
    return LatchedClock(nodes, "GevTimestampControlLatch", "GevTimestampValue", tick_frequency_hz), ()
