"""The camera's clock, mapped to the host's CLOCK_MONOTONIC."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from drivers.frames import Frame, Side
from drivers.genicam.nodes import NodeMap

LATCH_TRIES = 5
"""A latch is accurate to half its round trip (0.1 ms on a quiet wire); the quickest of a few is kept."""
COMPARED_DELAYS = 60
"""Recent frames only: the delay changes with the exposure time."""
SURE_FRAMES = 5
"""One of this many arrives undelayed unless the machine is very busy; a late one would look like the next trigger's."""
ARRIVAL_WINDOW = 600
"""Frames whose delays are compared without a latch: 10 s at 60 Hz; crystals of 50 ppm drift by 0.5 ms in it."""
LONG_PAUSE_NS = 10_000_000_000
"""Between two frames: after it, the delays before it are not compared, as the crystals have drifted meanwhile."""
LATCH_ERROR_NS = 1_000_000
"""A latch that had to wait for the processor may be off by this much: not a jump."""
OUT_OF_ORDER_NS = 100_000_000
"""A frame given up late may arrive after newer ones: not a jump either."""
JUMP_NS = 500_000_000
"""A clock that moves this much against the host's between two frames has jumped; drift and latches are smaller."""
NANOSECONDS = 1_000_000_000


class DeviceClock(Protocol):
    """Maps device time to host time."""

    def host_time_ns(self, device_time_ns: int, arrival_time_ns: int, in_order: bool = True) -> int | None:
        """Host time of a frame's time stamp, the frame having arrived at `arrival_time_ns`; None: unknown.

        `in_order` says whether the frame was taken after the last one, according to their numbers.
        """

    def latch(self) -> int | None:
        """Measure the mapping again, if the camera allows it; returns host time minus device time (ns)."""


class LatchedClock:
    """Latches the camera's clock between two readings of the host's; the offset refers to their midpoint.

    A jump is noticed at the next frame, whose time stamp is then in the future or before the last one. The first few
    host times after it are unknown. From then until the next latch, the quickest frame since the jump is assumed to
    have taken as long as the quickest before it.

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
        self._newest_ns = 0  # the last time stamp
        self._delays_ns: deque[int] = deque(maxlen=COMPARED_DELAYS)  # from time stamp to arrival
        self._since_jump: int | None = None  # frames; None: it has not jumped since the last latch
        self.latch()

    def latch(self) -> int:
        """Measure the offset again, and return it; a drift of some ppm moves it by microseconds a second."""
        _, self._offset_ns = min(self._sample() for _ in range(LATCH_TRIES))
        self._since_jump = None
        return self._offset_ns

    def _sample(self) -> tuple[int, int]:
        """Round trip and offset (both ns) of one latch."""
        before_ns = self._now_ns()
        self._nodes.execute(self._command)
        round_trip_ns = self._now_ns() - before_ns
        ticks = self._nodes.read_integer(self._value)
        device_ns = ticks * NANOSECONDS // self._tick_frequency_hz
        return round_trip_ns, before_ns + round_trip_ns // 2 - device_ns

    def host_time_ns(self, device_time_ns: int, arrival_time_ns: int, in_order: bool = True) -> int | None:
        """Host time of a time stamp; the arrival shows whether the clock has jumped."""
        jumped_back = _jumped_back(device_time_ns, self._newest_ns, in_order)
        self._newest_ns = device_time_ns
        in_the_future = device_time_ns + self._offset_ns > arrival_time_ns + LATCH_ERROR_NS
        if jumped_back or (in_the_future and self._since_jump is None):
            self._since_jump, self._offset_ns = 1, self._offset_by(device_time_ns, arrival_time_ns)
        elif self._since_jump is not None:
            self._since_jump += 1
            self._offset_ns = min(self._offset_ns, self._offset_by(device_time_ns, arrival_time_ns))
        else:
            self._delays_ns.append(arrival_time_ns - device_time_ns - self._offset_ns)
        if self._since_jump is not None and self._since_jump < SURE_FRAMES:
            return None
        return device_time_ns + self._offset_ns

    def _offset_by(self, device_time_ns: int, arrival_time_ns: int) -> int:
        """The offset, if this frame took as long to arrive as the quickest recent one."""
        return arrival_time_ns - min(self._delays_ns, default=0) - device_time_ns


class ArrivalClock:
    """For cameras without a latch: the quickest recent frame is assumed to have arrived at once.

    These host times are late by the shortest delay from time stamp to arrival (exposure, readout and transfer).
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=ARRIVAL_WINDOW)
        self._newest_ns = 0  # the last time stamp
        self._arrived_ns = 0  # when the last frame arrived

    def host_time_ns(self, device_time_ns: int, arrival_time_ns: int, in_order: bool = True) -> int:
        """Host time of a frame's time stamp; never later than its arrival."""
        jumped_back = _jumped_back(device_time_ns, self._newest_ns, in_order)  # which would count as a delay
        if jumped_back or arrival_time_ns - self._arrived_ns > LONG_PAUSE_NS:
            self._offsets_ns.clear()
        self._newest_ns, self._arrived_ns = device_time_ns, arrival_time_ns
        self._offsets_ns.append(arrival_time_ns - device_time_ns)
        return device_time_ns + min(self._offsets_ns)

    def latch(self) -> None:
        """Does nothing: the mapping comes from frames alone."""


def _jumped_back(device_time_ns: int, last_ns: int, in_order: bool) -> bool:
    """Whether a clock has jumped back between two frames that arrived one after the other."""
    return device_time_ns < last_ns - (0 if in_order else OUT_OF_ORDER_NS)


class JumpWatch:
    """Detects from frames that the clock of a camera has jumped."""

    def __init__(self) -> None:
        self._offsets_ns: dict[Side, int] = {}

    def frame(self, side: Side, frame: Frame) -> float:
        """By how many seconds the camera's clock has jumped since its last frame, 0 when it has not."""
        offset_ns = frame.device_time_ns - frame.host_time_ns
        jump_ns = offset_ns - self._offsets_ns.get(side, offset_ns)
        self._offsets_ns[side] = offset_ns
        return jump_ns * 1e-9 if abs(jump_ns) > JUMP_NS else 0.0

    def gone(self, side: Side) -> None:
        """The camera is lost: its clock may have restarted when it returns."""
        self._offsets_ns.pop(side, None)


def find_clock(nodes: NodeMap) -> tuple[DeviceClock, tuple[str, ...]]:
    """The best clock mapping that this camera allows, and its limitations in words."""
    if nodes.available("TimestampLatch") and nodes.available("TimestampLatchValue"):
        return LatchedClock(nodes, "TimestampLatch", "TimestampLatchValue", NANOSECONDS), ()
    if nodes.available("GevTimestampControlLatch") and nodes.available("GevTimestampValue"):
        tick_frequency_hz = NANOSECONDS
        if nodes.available("GevTimestampTickFrequency"):
            tick_frequency_hz = nodes.read_integer("GevTimestampTickFrequency") or NANOSECONDS
        return LatchedClock(nodes, "GevTimestampControlLatch", "GevTimestampValue", tick_frequency_hz), ()
    return ArrivalClock(), ("no time stamp latch: host times are inferred from arrival, late by the shortest delay",)
