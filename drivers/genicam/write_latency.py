"""How long after a write exposures show it, measured by the brightness of the frames around it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

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
