"""Where consumers track well, from their reports on frames that control has seen."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Final

from autoexpose_daemon.control.picture.steering import Steering
from autoexpose_daemon.control.picture.tracked_cells import TrackedCells
from autoexpose_daemon.control.picture.tracking_memory import CellExposure, TrackingMemory
from autoexpose_daemon.status.inputs.tracking import TrackingRefusal, TrackingTally
from drivers.log_throttle import LogThrottle
from imaging.frames import Side

log = logging.getLogger(__name__)

MOST_AGE_S: Final = 1.0
"""Longest time from a frame to the report on it."""

APART_NS: Final = 2_000_000
"""How far the stamp of a report may be from its frame's: the clock behind both may be slewed in between."""

MOST_WAITING: Final = 16
"""Reports that may wait for the next frame: on both cameras, from as many consumers as can steer."""

_SAID_S = 60.0
_WORDS = {
    TrackingRefusal.NO_CAMERA: "the rig has no {side} camera",
    TrackingRefusal.FUTURE: "its stamp lies in the future: send that of the frame",
    TrackingRefusal.STALE: f"its frame is older than {MOST_AGE_S:g} s",
    TrackingRefusal.UNKNOWN_FRAME: "no frame has its stamp: send that of the frame",
    TrackingRefusal.TOO_MANY: "as many other consumers as can steer report already",
}


class Tracking:
    """Keeps what consumers report. Reports arrive on one thread, control asks on another; neither waits for the other.

    Parameters
    ----------
    sides
        The rig's cameras.
    rate_hz
        Rate of the frames.
    now_ns
        The clock: CLOCK_MONOTONIC, except in virtual time.

    Attributes
    ----------
    tally
        For the status.
    """

    def __init__(self, sides: Collection[Side], rate_hz: float, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.tally = TrackingTally()
        self._sides = sides
        self._now_ns = now_ns
        self._memory = TrackingMemory()
        self._waiting: deque[tuple[TrackedCells, int]] = deque()
        self._seen: deque[tuple[int, Mapping[Side, CellExposure]]] = deque(maxlen=math.ceil(MOST_AGE_S * rate_hz) + 1)
        self._throttle = LogThrottle(_SAID_S)

    def take(self, report: TrackedCells, taken_ns: int) -> None:
        """A report has arrived; its stamp is `taken_ns` on CLOCK_MONOTONIC."""
        if len(self._waiting) >= MOST_WAITING:
            self._refuse(TrackingRefusal.TOO_OFTEN)
        else:
            self._waiting.append((report, taken_ns))

    def refuse(self) -> None:
        """Something other than a report has arrived."""
        self._refuse(TrackingRefusal.DAMAGED)

    def saw(self, stamped_ns: int, exposures: Mapping[Side, CellExposure]) -> None:
        """Control has seen the frames with this stamp (CLOCK_MONOTONIC), or passed them over, with no `exposures`."""
        self._seen.append((stamped_ns, exposures))

    def __call__(self, frame_ns: int) -> Steering | None:
        """What is known at a frame taken at `frame_ns` (CLOCK_MONOTONIC); None: nothing. Called once per decision."""
        for _ in range(len(self._waiting)):
            self._judge(*self._waiting.popleft())
        return self._memory.steering(frame_ns * 1e-9)

    def decided(self, steering: Steering | None) -> None:
        """A decision was made with this steering; None: without any."""
        self.tally.by, self.tally.age_s = ((), None) if steering is None else (steering.by, steering.age_s)

    def _judge(self, report: TrackedCells, taken_ns: int) -> None:
        """Take a report into the memory, or refuse it."""
        found = self._frame(report, taken_ns)
        if isinstance(found, CellExposure):
            self._memory.take(report, found, taken_ns * 1e-9)
            self.tally.reports += 1
            return
        self._refuse(found)
        if found in _WORDS and self._throttle.due(found, self._now_ns()):
            reason = _WORDS[found].format(side=report.side)
            log.warning("a report of consumer %s on its tracking is ignored: %s", report.consumer, reason)

    def _frame(self, report: TrackedCells, taken_ns: int) -> CellExposure | TrackingRefusal:
        """How the frame that is reported on was exposed, or why the report is ignored."""
        now_ns = self._now_ns()
        stamped_ns, exposures = min(self._seen, key=lambda seen: abs(seen[0] - taken_ns), default=(0, {}))
        doubts = {
            TrackingRefusal.NO_CAMERA: report.side not in self._sides,
            TrackingRefusal.FUTURE: taken_ns > now_ns + APART_NS,
            TrackingRefusal.STALE: taken_ns < now_ns - MOST_AGE_S * 1e9,
            TrackingRefusal.UNKNOWN_FRAME: abs(stamped_ns - taken_ns) > APART_NS,
            TrackingRefusal.PASSED_OVER: report.side not in exposures,
            TrackingRefusal.TOO_MANY: not self._memory.has_room(report.consumer, taken_ns * 1e-9),
        }
        return next((refusal for refusal, holds in doubts.items() if holds), None) or exposures[report.side]

    def _refuse(self, reason: TrackingRefusal) -> None:
        self.tally.refused[reason] += 1
