"""Whether the cameras start as many frames as they are triggered for, all along."""

from __future__ import annotations

import statistics
from collections.abc import Collection
from dataclasses import dataclass, field

from drivers.frames import Frame, Side

JUDGED_FRAMES = 20
"""Their median does not mind a pause, a clock that jumps, or a time stamp a little off."""

RATE_TOLERANCE = 0.01


def wrong_rate(period_ns: float, rate_hz: float, triggered: bool = True) -> str | None:
    """What is wrong with a camera that starts a frame every `period_ns`, with what to look at; None for nothing."""
    periods = period_ns * 1e-9 * rate_hz
    if abs(periods - 1.0) <= RATE_TOLERANCE:
        return None
    seen = f"starts {1e9 / period_ns:.1f} frames a second where trigger.rate_hz is {rate_hz:g}"
    if not triggered:
        return f"{seen}: it does not run as it was told"
    if round(periods) > 1 and abs(periods / round(periods) - 1.0) <= RATE_TOLERANCE:
        return f"{seen}: check the trigger source, and that exposure and readout fit into one period"
    return f"{seen}: check the trigger source, or configure its rate"


@dataclass(slots=True)
class _Course:
    """Of one camera: the last frame, the periods since the last verdict, and that verdict on which period."""

    frame_id: int
    time_ns: int
    periods_ns: list[float] = field(default_factory=list)
    trouble: str | None = None
    judged_ns: float = 0.0

    def judge(self, rate_hz: float, triggered: bool) -> None:
        """Find a verdict, or stay with the last one when the rate is as good as the same."""
        period_ns = max(statistics.median(self.periods_ns), 1.0)
        self.periods_ns.clear()
        trouble = wrong_rate(period_ns, rate_hz, triggered)
        if self.trouble and trouble and abs(period_ns / self.judged_ns - 1.0) <= RATE_TOLERANCE:
            return
        self.trouble, self.judged_ns = trouble, period_ns


class RateWatch:
    """Judges every twenty frames of each camera. Frames that were taken and lost on the way do not matter.

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
        """The camera is lost: its frames will count anew."""
        self._courses.pop(side, None)
