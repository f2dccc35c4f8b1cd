"""How fast the camera turns, from the newest sample of an IMU, while it is fresh."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

from autoexpose_daemon.config.motion import ImuConfig
from autoexpose_daemon.status.counters import Counts
from autoexpose_daemon.status.inputs.imu import ImuTally

log = logging.getLogger(__name__)

_SETTLED_NS = 1_000_000_000
"""The IMU counts as back after a second without a gap, so one that comes and goes is logged once."""
_FULL_TURN_RAD_S = math.tau
_TURNING_NS = 1_000_000_000
"""No robot with cameras keeps turning so fast for so long, which is once right round; one in degrees seems to do so as
soon as it turns by 6.3 degrees a second."""
_DISTRUST_NS = 60_000_000_000
"""After that, so that the slower turns between are not believed either."""


class AngularRate:
    """Keeps the newest sample. Samples arrive on one thread, control asks on another; neither waits for the other.

    Parameters
    ----------
    config
        The key, for the log, and how old a sample may be.
    counts
        Where decisions without a rate are counted.
    now_ns
        The clock: CLOCK_MONOTONIC, except in virtual time.

    Attributes
    ----------
    tally
        For the status.
    no_source
        Why there can be no samples, in words; empty if there should be some.
    """

    def __init__(self, config: ImuConfig, counts: Counts, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.tally = ImuTally()
        self.no_source = ""
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

    def __call__(self) -> float | None:
        """The rate to decide by, rad/s; None: use optical flow. Called once per decision."""
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
