"""The servo that brings a clock to its master's: outliers are left out, the rest corrects offset and rate."""

from __future__ import annotations

from collections import deque
from statistics import median

STEP_NS = 1_000_000
"""A clock further off than this is set; one that is closer is steered."""

LOCKED_NS = 100_000
"""A clock that is locked is closer than this; now and then it may be further off."""

_FAR_SAMPLES = 3
"""A locked clock is set only after so many samples in a row that are too far, since one may be a mistake."""
_LOCKED_SAMPLES = 4
_MOST_CREDIT = 8
_MEASURED_S = 0.4
"""How long the drift is measured before the first steering."""
_OFFSET_PER_S = 0.7
_RATE_PER_S2 = _OFFSET_PER_S**2 / 4  # critically damped
_MOST_PPM = 500.0
_LONGEST_INTERVAL_S = 1.0  # after a gap one sample must not count more than this
_DELAYS = 15
_FEWEST_DELAYS = 3
_SLOW_NS = 20_000
"""A sample is left out when its messages took longer than this beyond three times the usual."""
_IMPOSSIBLE_NS = -5_000
"""Messages never arrive before they leave; less than this is due to the clocks' rates during the exchange."""


class Servo:
    """Decides from samples of the offset how a clock is set and steered.

    Attributes
    ----------
    offset_ns
        The clock's time minus the master's, at the last sample used.
    ppm
        How the clock is to be steered, against the drift of its crystal.
    """

    def __init__(self) -> None:
        self._delays: deque[int] = deque(maxlen=_DELAYS)
        self._far = 0
        self.offset_ns = 0
        self._restart()

    @property
    def locked(self) -> bool:
        """Whether the last samples were close: four in a row, and then two of three."""
        return self._credit >= _LOCKED_SAMPLES

    def sample(self, offset_ns: int, delay_ns: int, time_s: float) -> int | None:
        """Take a sample of the offset and the path's delay, at a time on any steady clock.

        Returns what to add to the clock at once, None if the sample is left out. Afterwards steer it by `ppm`.
        """
        self._delays.append(delay_ns)
        if len(self._delays) < _FEWEST_DELAYS:
            return None
        if not _IMPOSSIBLE_NS <= delay_ns <= 3 * median(self._delays) + _SLOW_NS:
            return None
        far = abs(offset_ns) > STEP_NS
        self._far = self._far + 1 if far else 0
        if far and self._steered_s is not None and self._far < _FAR_SAMPLES:
            return None
        self.offset_ns = offset_ns
        if far:
            self._restart()
        return self._measure(offset_ns, time_s) if self._steered_s is None else self._steer(offset_ns, time_s)

    def _restart(self) -> None:
        self._set_s: float | None = None
        self._steered_s: float | None = None
        self.ppm = 0.0
        self._credit = self._far = 0

    def _measure(self, offset_ns: int, time_s: float) -> int:
        """Set the clock; what it is off after a while tells its drift."""
        if self._set_s is None:
            self._set_s = time_s
            return -offset_ns
        if time_s - self._set_s < _MEASURED_S:
            return 0
        self._turn(offset_ns / (time_s - self._set_s))
        self._steered_s = time_s
        return -offset_ns

    def _steer(self, offset_ns: int, time_s: float) -> int:
        assert self._steered_s is not None
        seconds = min(time_s - self._steered_s, _LONGEST_INTERVAL_S)
        self._steered_s = time_s
        self._turn(_RATE_PER_S2 * offset_ns * seconds)
        credit = self._credit + (1 if abs(offset_ns) <= LOCKED_NS else -2)
        self._credit = min(max(credit, 0), _MOST_CREDIT)
        return -round(_OFFSET_PER_S * offset_ns * seconds)

    def _turn(self, ahead_ns_per_s: float) -> None:
        """Let the clock run slower by this."""
        self.ppm = min(max(self.ppm - 1e-3 * ahead_ns_per_s, -_MOST_PPM), _MOST_PPM)
