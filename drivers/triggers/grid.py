"""The grid of trigger times, learnt from the frames that triggers made."""

from __future__ import annotations

import math

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
