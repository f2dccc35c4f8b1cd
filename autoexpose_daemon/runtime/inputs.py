"""What control is given besides frames: the newest of each kind, while it is fresh."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Final

from autoexpose_daemon.config.document import ImuConfig
from autoexpose_daemon.control.inputs import LightAhead, LightSeries, TrackedCells
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.steering import CellExposure, Steering, TrackingMemory
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.messages.frames import MIDDLE, Stamping
from autoexpose_daemon.status.counters import Counts, ImuTally, LightTally, TrackingRefusal, TrackingTally
from drivers.log_throttle import LogThrottle
from imaging.frames import CameraName, FrameSet

log = logging.getLogger(__name__)

_SETTLED_NS = 1_000_000_000
"""The IMU counts as back after a second without a gap, so one that comes and goes is logged once."""
_FULL_TURN_RAD_S = math.tau
_TURNING_NS = 1_000_000_000
"""No robot with cameras keeps turning so fast for so long, which is once right round; one in degrees seems to do so as
soon as it turns by 6.3 degrees a second."""
_DISTRUST_NS = 60_000_000_000
"""After that, so that the slower turns between are not believed either."""


class InputSource:
    """Where one of the `StepInputs` besides the pair comes from."""

    def __call__(self, frame_ns: int) -> Any:
        """What is known at a frame taken at `frame_ns` (CLOCK_MONOTONIC); None: nothing. Asked before each decision."""
        raise NotImplementedError

    def decided(self, inputs: StepInputs, loops: Sequence[ControlLoop]) -> None:
        """Control has decided, given these inputs: the loop of each group of cameras, the first camera's first."""

    def passed_over(self, pair: FrameSet) -> None:
        """Control had no time for a pair."""


class AngularRate(InputSource):
    """Keeps the newest sample. Samples arrive on one thread, control asks on another; neither waits for the other.

    Decisions without a rate are counted in `counts`.
    """

    def __init__(self, config: ImuConfig, counts: Counts, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.tally = ImuTally()
        self.no_source = ""  # why there can be no samples, in words; empty if there should be some
        self._config = config
        self._counts = counts
        self._now_ns = now_ns
        self._newest: tuple[float, int] | None = None
        self._refused_last = False
        self._there_since_ns: int | None = None
        self._spins_since_ns: int | None = None
        self._distrusted_until_ns = 0

    def take(self, rate_rad_s: float) -> None:
        """A sample has arrived."""
        now_ns = self._now_ns()
        if rate_rad_s < _FULL_TURN_RAD_S:
            self._spins_since_ns = None
        elif self._spins_since_ns is None:
            self._spins_since_ns = now_ns
        elif now_ns - self._spins_since_ns >= _TURNING_NS:
            self._distrusted_until_ns = now_ns + _DISTRUST_NS
        self._newest, self._refused_last = (rate_rad_s, now_ns), False
        self.tally.samples += 1

    def refuse(self) -> None:
        """Something other than a sample has arrived."""
        self._refused_last = True
        self.tally.refused += 1

    def __call__(self, frame_ns: int) -> float | None:
        """The rate to decide by, rad/s; None: use optical flow."""
        now_ns, newest = self._now_ns(), self._newest
        rate_rad_s = None
        fresh = newest is not None and now_ns - newest[1] <= self._config.max_age_s * 1e9
        if newest is not None and fresh and now_ns >= self._distrusted_until_ns:
            rate_rad_s = newest[0]
        # Before the trouble: nobody reads a rate beside the reason why none is used.
        self.tally.angular_rate_rad_s = rate_rad_s
        if rate_rad_s is None:
            self._is_missing(fresh)
        else:
            self._is_there(now_ns)
        return rate_rad_s

    def _is_missing(self, fresh: bool) -> None:
        self._counts.decisions_without_imu += 1
        self._there_since_ns = None
        begins = not self.tally.trouble
        self.tally.trouble = self._trouble(fresh)
        if begins:
            log.warning("image speed comes from optical flow: %s", self.tally.trouble)

    def _is_there(self, now_ns: int) -> None:
        if not self.tally.trouble:
            return
        if self._there_since_ns is None:
            self._there_since_ns = now_ns
        if now_ns - self._there_since_ns >= _SETTLED_NS:
            self.tally.trouble = ""
            log.info("image speed comes from the IMU")

    def _trouble(self, fresh: bool) -> str:
        """Always the same words for the same trouble: each change of the state is logged."""
        if self.no_source:
            return self.no_source
        if self._refused_last:
            return f"{self._config.key} does not carry an angular velocity in rad/s"
        if fresh:
            return (
                f"by {self._config.key} the camera turned right round within a second: is that in degrees, not rad/s?"
            )
        if self._newest is None:
            return f"no IMU sample as {self._config.key} yet"
        return f"no IMU sample as {self._config.key} for more than {self._config.max_age_s:g} s"


OLDEST_LIGHT_S: Final = 0.5
"""Oldest message that counts: a robot that has changed its speed since is elsewhere."""


class ForetoldLight(InputSource):
    """Keeps the newest series. Messages arrive on one thread, control asks on another; neither waits for the other."""

    def __init__(self, rate_hz: float, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.tally = LightTally()
        self._rate_hz = rate_hz
        self._now_ns = now_ns
        self._newest: tuple[LightSeries, int] | None = None

    def take(self, series: LightSeries) -> None:
        """A series has arrived."""
        self._newest = series, self._now_ns()
        self.tally.messages += 1

    def refuse(self) -> None:
        """Something other than a series has arrived."""
        self.tally.refused += 1

    def __call__(self, frame_ns: int) -> LightAhead | None:
        """The series around a frame taken at `frame_ns` (CLOCK_MONOTONIC); None without a fresh and precise one."""
        newest = self._newest
        if newest is None or self._now_ns() - newest[1] > OLDEST_LIGHT_S * 1e9:
            return None
        series, came_ns = newest
        return series.in_frames((frame_ns - came_ns) * 1e-9, self._rate_hz)

    def decided(self, inputs: StepInputs, loops: Sequence[ControlLoop]) -> None:
        """Note how far the series was believed."""
        self.tally.belief = loops[0].light_belief


OLDEST_REPORT_S: Final = 1.0
"""Longest time from a frame to the report on it."""

APART_NS: Final = 2_000_000
"""How far the stamp of a report may be from its frame's: the clock behind both may be slewed in between."""

MOST_WAITING: Final = 16
"""Reports that may wait for the next frame: on two cameras, from as many consumers as can steer."""

_SAID_S = 60.0
_WORDS = {
    TrackingRefusal.NO_CAMERA: "the rig has no {camera} camera",
    TrackingRefusal.FUTURE: "its stamp lies in the future: send that of the frame",
    TrackingRefusal.STALE: f"its frame is older than {OLDEST_REPORT_S:g} s",
    TrackingRefusal.UNKNOWN_FRAME: "no frame has its stamp: send that of the frame",
    TrackingRefusal.TOO_MANY: "as many other consumers as can steer report already",
}


class Tracking(InputSource):
    """Keeps what consumers report. Reports arrive on one thread, control asks on another; neither waits for the other.

    `stamping` is that of the frames that reports are on.
    """

    def __init__(
        self,
        cameras: Collection[CameraName],
        rate_hz: float,
        stamping: Stamping = MIDDLE,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.tally = TrackingTally()
        self._cameras = cameras
        self._stamping = stamping
        self._ptp_ahead_ns: int | None = None  # at the newest frame
        self._now_ns = now_ns
        self._memory = TrackingMemory()
        self._waiting: deque[tuple[TrackedCells, int]] = deque()
        self._seen: deque[tuple[int, Mapping[CameraName, CellExposure]]] = deque(
            maxlen=math.ceil(OLDEST_REPORT_S * rate_hz) + 1
        )
        self._throttle = LogThrottle(_SAID_S)

    def taken_ns(self, stamp_ns: int, realtime_offset_ns: int) -> int:
        """What CLOCK_MONOTONIC was at a frame's stamp; `realtime_offset_ns` is what CLOCK_REALTIME is ahead of it."""
        ahead_ns = self._ptp_ahead_ns
        return stamp_ns - (realtime_offset_ns if ahead_ns is None else ahead_ns)

    def take(self, report: TrackedCells, taken_ns: int) -> None:
        """A report has arrived; its stamp is `taken_ns` on CLOCK_MONOTONIC."""
        if len(self._waiting) >= MOST_WAITING:
            self._refuse(TrackingRefusal.TOO_OFTEN)
        else:
            self._waiting.append((report, taken_ns))

    def refuse(self) -> None:
        """Something other than a report has arrived."""
        self._refuse(TrackingRefusal.DAMAGED)

    def saw(self, stamped_ns: int, exposures: Mapping[CameraName, CellExposure]) -> None:
        """Control has seen the frames with this stamp (CLOCK_MONOTONIC), or passed them over, with no `exposures`."""
        self._seen.append((stamped_ns, exposures))

    def __call__(self, frame_ns: int) -> Steering | None:
        """Where consumers track well; None: nobody knows."""
        for _ in range(len(self._waiting)):
            self._judge(*self._waiting.popleft())
        return self._memory.steering(frame_ns * 1e-9)

    def decided(self, inputs: StepInputs, loops: Sequence[ControlLoop]) -> None:
        """Note who steered, and how the frames were exposed."""
        steering = inputs.steering if any(loop.steered for loop in loops) else None
        self.tally.by, self.tally.age_s = ((), None) if steering is None else (steering.by, steering.age_s)
        exposures = {camera: each for loop in loops for camera, each in loop.cell_exposures.items()}
        self._saw_pair(inputs.pair, exposures)

    def passed_over(self, pair: FrameSet) -> None:
        """Nothing is known of how its frames were exposed."""
        self._saw_pair(pair, {})

    def _saw_pair(self, pair: FrameSet, exposures: Mapping[CameraName, CellExposure]) -> None:
        self._ptp_ahead_ns = self._stamping.ptp_ahead_ns(pair.reference)
        self.saw(self._stamping.moment_ns(pair.reference), exposures)

    def _judge(self, report: TrackedCells, taken_ns: int) -> None:
        """Take a report into the memory, or refuse it."""
        found = self._frame(report, taken_ns)
        if isinstance(found, CellExposure):
            self._memory.take(report, found, taken_ns * 1e-9)
            self.tally.reports += 1
            return
        self._refuse(found)
        if found in _WORDS and self._throttle.due(found, self._now_ns()):
            reason = _WORDS[found].format(camera=report.camera)
            log.warning("a report of consumer %s on its tracking is ignored: %s", report.consumer, reason)

    def _frame(self, report: TrackedCells, taken_ns: int) -> CellExposure | TrackingRefusal:
        """How the frame that is reported on was exposed, or why the report is ignored."""
        now_ns = self._now_ns()
        stamped_ns, exposures = min(self._seen, key=lambda seen: abs(seen[0] - taken_ns), default=(0, {}))
        refusals = {
            TrackingRefusal.NO_CAMERA: report.camera not in self._cameras,
            TrackingRefusal.FUTURE: taken_ns > now_ns + APART_NS,
            TrackingRefusal.STALE: taken_ns < now_ns - OLDEST_REPORT_S * 1e9,
            TrackingRefusal.UNKNOWN_FRAME: abs(stamped_ns - taken_ns) > APART_NS,
            TrackingRefusal.PASSED_OVER: report.camera not in exposures,
            TrackingRefusal.TOO_MANY: not self._memory.has_room(report.consumer, taken_ns * 1e-9),
        }
        return next((refusal for refusal, holds in refusals.items() if holds), None) or exposures[report.camera]

    def _refuse(self, reason: TrackingRefusal) -> None:
        self.tally.refused[reason] += 1
