"""The grid of trigger times, and whether the cameras keep to it."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from imaging.frames import CameraName, Frame

_PHASE_GAIN = 0.2  # follows clock latches (tens of us a second) within a few frames, averages their jitter
_PERIOD_GAIN = 0.01  # an hour's outage must not cost a trigger at crystal precision, so the rate is averaged long
_OFF_PHASE = 0.3  # of a period; a rate that is 5 % off stays within 0.2
_LARGEST_RATE_ERROR = 0.01  # further off is another rate, not tolerance


class TriggerGrid:
    """Numbers trigger times (host clock, ns): trigger n is expected at ``time_of(n)``.

    The first time given becomes a trigger; later ones adjust the phase, and the period around the nominal one.
    """

    def __init__(self, nominal_period_ns: float, first_time_ns: int, first_trigger: int = 0) -> None:
        self._nominal_period_ns = nominal_period_ns
        self._period_ns = nominal_period_ns
        self._trigger = first_trigger
        self._time_ns = float(first_time_ns)
        self._elapsed: float = math.inf  # triggers, from the last but one seen to the last

    @property
    def period_ns(self) -> float:
        """The trigger period as seen, in ns of the host clock."""
        return self._period_ns

    def time_of(self, trigger: int) -> float:
        """When `trigger` is expected (host clock, ns)."""
        return self._time_ns + (trigger - self._trigger) * self._period_ns

    def last_before(self, time_ns: float) -> int:
        """The last trigger at or before `time_ns`."""
        return self._trigger + int((time_ns - self._time_ns) // self._period_ns)

    def locate(self, time_ns: int) -> int:
        """The trigger nearest to `time_ns`."""
        return self._trigger + round((time_ns - self._time_ns) / self._period_ns)

    def off_phase(self, time_ns: int) -> bool:
        """Whether `time_ns` lies between triggers, further off than jitter explains."""
        return abs(time_ns - self.time_of(self.locate(time_ns))) > _OFF_PHASE * self._period_ns

    def restart(self, time_ns: int) -> None:
        """Triggers resume at `time_ns` in another phase: that becomes the time of the trigger nearest to it."""
        self._trigger = self.locate(time_ns)
        self._time_ns = float(time_ns)
        self._elapsed = math.inf

    def observe(self, trigger: int, time_ns: int) -> None:
        """Learn that `trigger` was at `time_ns`; ignored if it is older than the newest.

        The period follows all frames of a trigger, as the phase does: by the first one's alone, cameras that start a
        little apart would seem to be triggered at another rate.
        """
        elapsed = trigger - self._trigger
        if elapsed < 0:
            return
        expected_ns = self.time_of(trigger)
        error_ns = time_ns - expected_ns
        self._elapsed = elapsed or self._elapsed
        period_ns = self._period_ns + _PERIOD_GAIN * error_ns / self._elapsed
        tolerance_ns = _LARGEST_RATE_ERROR * self._nominal_period_ns
        self._period_ns = min(
            max(period_ns, self._nominal_period_ns - tolerance_ns), self._nominal_period_ns + tolerance_ns
        )
        self._time_ns = expected_ns + _PHASE_GAIN * error_ns
        self._trigger = trigger


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

    `rate_hz` is that of the triggers, as configured; cameras that are not `triggered` run by their own clock, at the
    same rate. `tolerance` says how far it may be off, in parts.
    """

    def __init__(self, rate_hz: float, triggered: Collection[CameraName], tolerance: float = RATE_TOLERANCE) -> None:
        self._rate_hz = rate_hz
        self._triggered = triggered
        self._tolerance = tolerance
        self._courses: dict[CameraName, _Course] = {}

    def frame(self, camera: CameraName, frame: Frame) -> str | None:
        """What is wrong with the rate of a camera as of this frame, in words; None: nothing."""
        course = self._courses.get(camera)
        if course is None:
            self._courses[camera] = _Course(frame.frame_id, frame.host_time_ns)
            return None
        taken = frame.frame_id - course.frame_id
        if taken > 0:
            course.periods_ns.append((frame.host_time_ns - course.time_ns) / taken)
        course.frame_id, course.time_ns = frame.frame_id, frame.host_time_ns
        if len(course.periods_ns) == JUDGED_FRAMES:
            course.judge(self._rate_hz, camera in self._triggered, self._tolerance)
        return course.trouble

    def gone(self, camera: CameraName) -> None:
        """The camera is lost: its frames are counted afresh when it returns."""
        self._courses.pop(camera, None)


PATIENCE_NS = 3_000_000_000
PATIENCE_PERIODS = 3
"""A camera that has waited longer than both has no trigger."""

START_FRAMES = 20
"""The latest of each camera: enough for a verdict that a lost frame or two does not change, and so few that a trigger
generator a little off its rate does not drift by `SKEW_TOLERANCE`."""

SKEW_TOLERANCE = 0.1
"""Part of a period by which cameras may start apart; on one trigger wire it is a few microseconds."""


class StartCheck:
    """Checks that triggers arrive at `rate_hz`, and that cameras start together.

    `sources` gives the TriggerSource of each camera; one that runs freely has none and is not judged. With
    `by_host` the host gives the triggers: there is no wire to check. Times are CLOCK_MONOTONIC, in ns.
    """

    def __init__(self, sources: Mapping[CameraName, str], rate_hz: float, by_host: bool = False) -> None:
        self._sources = sources
        self._by_host = by_host
        self._rate_hz = rate_hz
        self._patience_ns = max(PATIENCE_NS, round(PATIENCE_PERIODS * 1e9 / rate_hz))
        self._waits_since_ns: dict[CameraName, int] = {}
        self._triggered: set[CameraName] = set()
        self._times_ns: dict[CameraName, deque[int]] = {camera: deque(maxlen=START_FRAMES) for camera in sources}
        self._reported: set[str] = set()
        self._done = False

    def ready(self, camera: CameraName, now_ns: int) -> None:
        """A camera waits for triggers from now on."""
        if camera in self._sources and camera not in self._triggered:
            self._waits_since_ns[camera] = now_ns

    def gone(self, camera: CameraName) -> None:
        """A camera is lost, or could not be opened: that it sends nothing is not for want of triggers."""
        self._waits_since_ns.pop(camera, None)

    def frame(self, camera: CameraName, time_ns: int | None) -> None:
        """A camera started an exposure, whatever became of its frame; None: at an unknown time."""
        if camera not in self._sources:
            return
        self._waits_since_ns.pop(camera, None)
        self._triggered.add(camera)
        if time_ns is not None:
            self._times_ns[camera].append(time_ns)

    def findings(self, now_ns: int) -> list[str]:
        """What is wrong, and what to check on the robot; each finding only once."""
        if self._done:
            return []
        self._done = all(len(times_ns) == START_FRAMES for times_ns in self._times_ns.values())
        new = [finding for finding in self._all(now_ns) if finding not in self._reported]
        self._reported.update(new)
        return new

    def _all(self, now_ns: int) -> Iterator[str]:
        yield from self._without_pulses(now_ns)
        judged = {camera: times_ns for camera, times_ns in self._times_ns.items() if len(times_ns) == START_FRAMES}
        at_rate = [camera for camera, times_ns in judged.items() if self._at_rate(times_ns)]
        for other in at_rate[1:]:  # at another rate the skew means nothing
            yield from self._skew(at_rate[0], other)

    def _without_pulses(self, now_ns: int) -> Iterator[str]:
        waiting = self._waits_since_ns.items()
        silent = [camera for camera, since_ns in waiting if now_ns - since_ns > self._patience_ns]
        if silent and len(silent) == len(waiting) and not self._triggered:
            sources = " and ".join(sorted({self._sources[camera] for camera in silent}))
            waited = f"{self._patience_ns * 1e-9:.3g} s"
            yield (
                f"no trigger pulse on {sources} for {waited}: check that the trigger source runs, its "
                "wires and its voltage"
                if not self._by_host
                else f"no frame for {waited} although the cameras are triggered: check the network"
            )
            return
        if not any(len(times_ns) == START_FRAMES for times_ns in self._times_ns.values()):
            return  # the first pulse may just have come, and one camera's frame before the other's
        for camera in silent:
            yield (
                f"the {camera} camera gets no trigger pulse, another one does: check the wire to its "
                f"{self._sources[camera]}"
                if not self._by_host
                else f"no frame from the {camera} camera although it is triggered: check its cable"
            )

    def _at_rate(self, times_ns: Iterable[int]) -> bool:
        period_ns = mean_period_ns([later - earlier for earlier, later in pairwise(times_ns)])
        return wrong_rate(period_ns, self._rate_hz) is None

    def _skew(self, one: CameraName, other: CameraName) -> Iterator[str]:
        period_ns = 1e9 / self._rate_hz
        starts_ns = zip(self._times_ns[one], self._times_ns[other], strict=True)
        skews_ns = [abs(math.remainder(late - early, period_ns)) for early, late in starts_ns]
        skew_ns = statistics.median(skews_ns)
        if skew_ns > SKEW_TOLERANCE * period_ns:
            apart = f"{one} and {other} start {skew_ns * 1e-6:.1f} ms apart: check that"
            yield (
                f"{apart} both share one trigger, and that neither has a TriggerDelay or triggers on another edge"
                if not self._by_host
                else f"{apart} neither has a TriggerDelay, and that this machine is not too busy to trigger in time"
            )
