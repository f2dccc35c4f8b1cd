"""Whether the cameras keep starting frames at the trigger rate."""

from __future__ import annotations

import math
import statistics
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from imaging.frames import Frame, Side

JUDGED_FRAMES = 30
"""Per window: its mean is within 0.2 % where triggers lie on a grid of milliseconds (17, 17, 16 ms are 60 Hz)."""

RATE_TOLERANCE = 0.01
"""How far a rate may be off. A wrong one is right again at half of this, so that verdicts do not flicker."""

HOST_RATE_TOLERANCE = 0.3
"""How far the rate of triggers that the host gives may be off: it leaves some out, but knows that; a camera that takes
only every second one is another matter."""


def mean_period_ns(periods_ns: Sequence[float]) -> float:
    """The mean period of frames whose times scatter, without pauses, clock jumps and gaps of lost frames."""
    typical_ns = statistics.median_high(periods_ns)
    near_ns = [period_ns for period_ns in periods_ns if abs(period_ns - typical_ns) <= 0.75 * abs(typical_ns)]
    return max(statistics.fmean(near_ns), 1.0)


def wrong_rate(
    period_ns: float, rate_hz: float, triggered: bool = True, tolerance: float = RATE_TOLERANCE
) -> str | None:
    """What is wrong with a camera that starts a frame every `period_ns`, and what to check; None: nothing."""
    periods = period_ns * 1e-9 * rate_hz
    if abs(periods - 1.0) <= tolerance:
        return None
    seen = f"starts {1e9 / period_ns:.1f} frames a second where trigger.rate_hz is {rate_hz:g}"
    if not triggered:
        return f"{seen}: it does not keep its configured rate"
    if round(periods) > 1 and abs(periods / round(periods) - 1.0) <= RATE_TOLERANCE:
        return f"{seen}: check the trigger source, and that exposure and readout fit into one period"
    return f"{seen}: check the trigger source, or configure its rate"


@dataclass(slots=True)
class _Course:
    """One camera's last frame, current window, mean of the window before, verdict, and the mean behind it."""

    frame_id: int
    time_ns: int
    periods_ns: list[float] = field(default_factory=list)
    window_ns: float = math.inf
    trouble: str | None = None
    judged_ns: float = 0.0

    def judge(self, rate_hz: float, triggered: bool, tolerance: float) -> None:
        """Close a window: a verdict rests on two in a row that agree, and stays while the rate hardly changes.

        A time stamp that is a little off lengthens one window and shortens the next, and a window in which the rate
        changes agrees with neither neighbour.
        """
        former_ns, self.window_ns = self.window_ns, mean_period_ns(self.periods_ns)
        self.periods_ns.clear()
        if not _same(self.window_ns, former_ns):
            return
        tolerance = tolerance / 2 if self.trouble else tolerance
        period_ns = (former_ns + self.window_ns) / 2
        trouble = wrong_rate(period_ns, rate_hz, triggered, tolerance)
        if self.trouble and trouble and _same(period_ns, self.judged_ns):
            return
        self.trouble, self.judged_ns = trouble, period_ns


def _same(period_ns: float, other_ns: float) -> bool:
    return abs(period_ns / other_ns - 1.0) <= RATE_TOLERANCE


class RateWatch:
    """Judges windows of thirty frames of each camera. Frames that were taken and lost on the way do not matter.

    Parameters
    ----------
    rate_hz
        Rate of the triggers, as configured.
    triggered
        The cameras that wait for them; others run by their own clock, at the same rate.
    tolerance
        How far the rate may be off, in parts.
    """

    def __init__(self, rate_hz: float, triggered: Collection[Side], tolerance: float = RATE_TOLERANCE) -> None:
        self._rate_hz = rate_hz
        self._triggered = triggered
        self._tolerance = tolerance
        self._courses: dict[Side, _Course] = {}

    def frame(self, side: Side, frame: Frame) -> str | None:
        """What is wrong with the rate of a camera as of this frame, in words; None: nothing."""
        course = self._courses.get(side)
        if course is None:
            self._courses[side] = _Course(frame.frame_id, frame.host_time_ns)
            return None
        taken = frame.frame_id - course.frame_id
        if taken > 0:
            course.periods_ns.append((frame.host_time_ns - course.time_ns) / taken)
        course.frame_id, course.time_ns = frame.frame_id, frame.host_time_ns
        if len(course.periods_ns) == JUDGED_FRAMES:
            course.judge(self._rate_hz, side in self._triggered, self._tolerance)
        return course.trouble

    def gone(self, side: Side) -> None:
        """The camera is lost: its frames are counted afresh when it returns."""
        self._courses.pop(side, None)
