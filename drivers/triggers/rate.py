"""Whether the cameras start as many frames as they are triggered for, all along."""

from __future__ import annotations

import math
import statistics
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from drivers.frames import Frame, Side

JUDGED_FRAMES = 30
"""Of one window: its mean is within 0.2 % where triggers lie on a grid of milliseconds (17, 17, 16 ms are 60 Hz)."""

RATE_TOLERANCE = 0.01
"""By so much a rate may be off. One found wrong is right again at half of it, so that no verdict comes and goes."""


def mean_period_ns(periods_ns: Sequence[float]) -> float:
    """The period of frames whose times scatter; a pause, a clock that jumps and a gap of lost frames are left out."""
    typical_ns = statistics.median_high(periods_ns)
    near_ns = [period_ns for period_ns in periods_ns if abs(period_ns - typical_ns) <= 0.75 * abs(typical_ns)]
    return max(statistics.fmean(near_ns), 1.0)


def wrong_rate(
    period_ns: float, rate_hz: float, triggered: bool = True, tolerance: float = RATE_TOLERANCE
) -> str | None:
    """What is wrong with a camera that starts a frame every `period_ns`, with what to look at; None for nothing."""
    periods = period_ns * 1e-9 * rate_hz
    if abs(periods - 1.0) <= tolerance:
        return None
    seen = f"starts {1e9 / period_ns:.1f} frames a second where trigger.rate_hz is {rate_hz:g}"
    if not triggered:
        return f"{seen}: it does not run as it was told"
    if round(periods) > 1 and abs(periods / round(periods) - 1.0) <= RATE_TOLERANCE:
        return f"{seen}: check the trigger source, and that exposure and readout fit into one period"
    return f"{seen}: check the trigger source, or configure its rate"


@dataclass(slots=True)
class _Course:
    """Of one camera: its last frame, the window under way, the mean of the one before, the verdict and on what mean."""

    frame_id: int
    time_ns: int
    periods_ns: list[float] = field(default_factory=list)
    window_ns: float = math.inf
    trouble: str | None = None
    judged_ns: float = 0.0

    def judge(self, rate_hz: float, triggered: bool) -> None:
        """Close a window: a verdict rests on two in a row that agree, and stays while the rate is as good as the same.

        A time stamp a little off makes one window longer and the next one shorter, and a change of rate within a window
        makes one that is like neither of its neighbours.
        """
        former_ns, self.window_ns = self.window_ns, mean_period_ns(self.periods_ns)
        self.periods_ns.clear()
        if not _same(self.window_ns, former_ns):
            return
        tolerance = RATE_TOLERANCE / 2 if self.trouble else RATE_TOLERANCE
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
    """

    def __init__(self, rate_hz: float, triggered: Collection[Side]) -> None:
        self._rate_hz = rate_hz
        self._triggered = triggered
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
            course.judge(self._rate_hz, side in self._triggered)
        return course.trouble

    def gone(self, side: Side) -> None:
        """The camera is lost: when it is back, its frames are counted afresh."""
        self._courses.pop(side, None)
