"""The setting that a frame was taken with, and how long after a write frames show it."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

from drivers.genicam.nodes import NodeMap, hold, is_number, offered, switch, us_per_unit
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting

FRAMES_AFTER = 4
"""No exposure loop can be built on a camera that takes more than three frames to show a write."""
DISTINCT_STOPS = 0.5
"""Smaller changes drown in those of the scene."""
SHOWN = 0.4
"""Part of the change that one step from frame to frame must show; saturated and dark pixels swallow the rest."""
REMEMBERED = 8


@dataclass(slots=True)
class _Write:
    """A write of `change_stops` at `time_ns`; the frame before it and those after as (start in ns, log2 of grey)."""

    time_ns: int
    change_stops: float
    frames: list[tuple[int, float]] = field(default_factory=list)


class WriteLatency:
    """The shortest delay from a write to the start of an exposure that shows it.

    Each distinct change with a few frames to itself is searched for in them. It lies between two frames, and the
    latency between their delays after the write. Not thread-safe.
    """

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None
        self._pending: _Write | None = None
        self._quiet = 0
        self._spans_ns: deque[tuple[int, int]] = deque(maxlen=REMEMBERED)

    @property
    def latency_ns(self) -> int:
        """Exposures that start this long after a write show it; 0 until a change was seen."""
        spans_ns = list(self._spans_ns)
        while spans_ns and max(early for early, _ in spans_ns) >= min(late for _, late in spans_ns):
            spans_ns.pop(0)  # one that contradicts newer ones was a change of light
        return max(max((early for early, _ in spans_ns), default=-1) + 1, 0)

    def write(self, time_ns: int, change_stops: float) -> None:
        """The camera was written at `time_ns`, its exposure level raised by `change_stops`."""
        if change_stops == 0.0:
            return
        alone = self._quiet >= FRAMES_AFTER
        self._pending = _Write(time_ns, change_stops) if alone and abs(change_stops) >= DISTINCT_STOPS else None
        self._quiet = 0

    def frame(self, start_ns: int, grey: float) -> None:
        """A frame of mean grey level `grey`, whose exposure started at `start_ns`; frames come in order."""
        self._quiet += 1
        seen = start_ns, math.log2(grey + 1.0)
        pending = self._pending
        if pending is not None and start_ns > pending.time_ns:
            if not pending.frames and self._last is not None:
                pending.frames.append(self._last)
            pending.frames.append(seen)
            if len(pending.frames) > FRAMES_AFTER:
                self._find(pending)
                self._pending = None
        self._last = seen

    def _find(self, write: _Write) -> None:
        """Find the two frames between which the change happened, if a single step shows it."""
        steps = [
            ((later - earlier) * math.copysign(1.0, write.change_stops), before_ns, after_ns)
            for (before_ns, earlier), (after_ns, later) in pairwise(write.frames)
        ]
        size, before_ns, after_ns = max(steps)
        others = sum(abs(step) for step, *_ in steps) - size
        if size >= SHOWN * abs(write.change_stops) and others < size / 2:
            self._spans_ns.append((before_ns - write.time_ns, after_ns - write.time_ns))


LEDGER_LENGTH = 64
"""Writes remembered: at one per frame, a second at 60 Hz, longer than any frame takes to arrive."""

_INFERRED = "a frame's setting is inferred from when it was written"


class SettingLedger:
    """Which setting a frame was taken with, for cameras that do not say so themselves.

    A setting applies to exposures that start at least the camera's latency after it was read back. The latency counts
    as zero until the brightness of frames has shown another (`WriteLatency`).
    """

    def __init__(self, setting: ExposureSetting) -> None:
        self._lock = threading.Lock()
        self._writes = deque([(0, setting)], maxlen=LEDGER_LENGTH)
        self._latency = WriteLatency()

    def record(self, host_time_ns: int, setting: ExposureSetting) -> None:
        """Note that the nodes read back `setting` at `host_time_ns`; times must not decrease."""
        with self._lock:
            self._latency.write(host_time_ns, setting.level - self._writes[-1][1].level)
            self._writes.append((host_time_ns, setting))

    def observe(self, host_time_ns: int, grey: float) -> None:
        """Learn from the mean grey level of the frame whose exposure started at `host_time_ns`, in their order."""
        with self._lock:
            self._latency.frame(host_time_ns, grey)

    def setting_at(self, host_time_ns: int) -> ExposureSetting:
        """The setting of an exposure that started at `host_time_ns`; before all writes, the oldest one remembered."""
        with self._lock:
            for written_ns, setting in reversed(self._writes):
                if written_ns + self._latency.latency_ns <= host_time_ns:
                    return setting
            return self._writes[0][1]


@dataclass(frozen=True, slots=True)
class ChunkNodes:
    """The chunk nodes that hold a frame's setting: exposure time in units of `us_per_unit`; `gain`, if it is driven.

    `gain` is in the numbers of the node that drives it; `gain_is_integer`: the chunk is read as an integer.
    """

    exposure_time: str
    us_per_unit: float
    gain: str | None
    gain_is_integer: bool = False


def enable_chunks(nodes: NodeMap, gain_node: str | None) -> tuple[ChunkNodes | None, tuple[str, ...]]:
    """Have each frame carry its exposure time and gain; None if the camera cannot, with the limitation in words.

    `gain_node` is what drives the gain, None if nothing does.
    """
    raw = gain_node == "GainRaw"
    wanted = ("ExposureTime", *(() if gain_node is None else ("GainAll",) if raw else ("Gain",)))
    try:
        if nodes.exists("ChunkSelector") and nodes.available("ChunkModeActive"):
            switch(nodes, "ChunkModeActive", True)  # first: some selectors exist only while it is on
            named = all(nodes.exists(f"Chunk{chunk}") for chunk in wanted)
            chunk_us = us_per_unit(nodes.unit("ChunkExposureTime")) if named else None
            if chunk_us is not None and set(wanted) <= set(offered(nodes, "ChunkSelector")):
                for chunk in wanted:
                    hold(nodes, "ChunkSelector", chunk)
                    switch(nodes, "ChunkEnable", True)
                gain = None if gain_node is None else f"Chunk{wanted[1]}"
                is_integer = gain is not None and is_number(nodes, gain, "integer")
                return ChunkNodes("ChunkExposureTime", chunk_us, gain, is_integer), ()
            switch(nodes, "ChunkModeActive", False)
    except NodeError as error:
        return None, (f"{_INFERRED} (chunk data cannot be switched on: {error})",)
    return None, (f"no chunk data of {' and '.join(wanted)}: {_INFERRED}",)
