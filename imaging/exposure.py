"""The vocabulary of exposure: time in microseconds, gain in dB, exposure level in stops."""

from __future__ import annotations

import math
from bisect import bisect
from dataclasses import dataclass

from imaging.errors import ConfigurationError
from imaging.python310 import exp2

DB_PER_STOP = 20.0 * math.log10(2.0)
"""A factor of two in linear gain, 6.02 dB: machine-vision gain is an amplitude ratio, hence 20 and not 10."""


_SHORTEST_TIME_US, _LONGEST_TIME_US = 1e-3, 3.6e9
_HIGHEST_GAIN_DB = 200.0

SAME_GAIN_DB = 0.1
"""Gains that differ by less count as the same one, rounded."""


def linear_gain(gain_db: float) -> float:
    """Linear gain of a gain in dB, ``10 ** (dB / 20)``."""
    return exp2(gain_db / DB_PER_STOP)


@dataclass(frozen=True, slots=True)
class ExposureSetting:
    """The exposure time (us) and gain (dB) that a frame is taken with."""

    exposure_time_us: float
    gain_db: float

    @property
    def level(self) -> float:
        """Exposure level E = log2(t * g) in stops, t in microseconds (Begin & Hunter 2022, eq. 1)."""
        return math.log2(self.exposure_time_us) + self.gain_db / DB_PER_STOP

    @property
    def is_physical(self) -> bool:
        """Whether a frame could be taken with it (1 ns to an hour, 200 dB): other processes may send anything."""
        in_time = _SHORTEST_TIME_US <= self.exposure_time_us <= _LONGEST_TIME_US
        return in_time and abs(self.gain_db) <= _HIGHEST_GAIN_DB

    def agrees_with(self, other: ExposureSetting) -> bool:
        """Whether the two are equal within the rounding of cameras (1 % of time, 0.1 dB)."""
        ratio = self.exposure_time_us / other.exposure_time_us
        return abs(ratio - 1.0) < 0.01 and abs(self.gain_db - other.gain_db) < SAME_GAIN_DB

    def __str__(self) -> str:
        return f"{self.exposure_time_us:.0f} us, {self.gain_db:.1f} dB"


@dataclass(frozen=True, slots=True)
class ExposureLimits:
    """Bounds of exposure time (us) and gain (dB), with the increments in which a camera takes them (0: any value).

    `gains_db`, rising, are the only gains that it takes, if their steps are uneven.
    """

    min_time_us: float
    max_time_us: float
    min_gain_db: float
    max_gain_db: float
    time_step_us: float = 0.0
    gain_step_db: float = 0.0
    gains_db: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.min_time_us <= self.max_time_us:
            raise ConfigurationError(
                f"exposure time limits {self.min_time_us:g} to {self.max_time_us:g} us leave no exposure time to choose"
            )
        if self.min_gain_db > self.max_gain_db:
            raise ConfigurationError(
                f"gain limits {self.min_gain_db:g} to {self.max_gain_db:g} dB leave no gain to choose"
            )

    @property
    def darkest(self) -> ExposureSetting:
        """The setting of the lowest exposure level."""
        return ExposureSetting(self.min_time_us, self.min_gain_db)

    @property
    def brightest(self) -> ExposureSetting:
        """The setting of the highest exposure level."""
        return ExposureSetting(self.max_time_us, self.max_gain_db)

    def contain(self, setting: ExposureSetting) -> bool:
        """Whether `setting` is within the bounds."""
        return (
            self.min_time_us <= setting.exposure_time_us <= self.max_time_us
            and self.min_gain_db <= setting.gain_db <= self.max_gain_db
        )

    def nearest(self, setting: ExposureSetting) -> ExposureSetting:
        """`setting` itself if the bounds contain it, else the one of the nearest level, with the nearest time."""
        return setting if self.contain(setting) else self.realise(setting.level, setting.exposure_time_us)

    def rounded(self, setting: ExposureSetting) -> ExposureSetting:
        """The time and the gain nearest to those of `setting`, each by itself, within bounds and increments."""
        return ExposureSetting(
            _quantise(setting.exposure_time_us, self.min_time_us, self.max_time_us, self.time_step_us),
            min(self.gains_db, key=lambda gain_db: abs(gain_db - setting.gain_db))
            if self.gains_db
            else _quantise(setting.gain_db, self.min_gain_db, self.max_gain_db, self.gain_step_db),
        )

    def clamp_level(self, level: float) -> float:
        """The exposure level within these limits nearest to `level` (stops)."""
        return min(max(level, self.darkest.level), self.brightest.level)

    def within(self, other: ExposureLimits) -> ExposureLimits:
        """The range common to both, with the coarser increments of the two, counted from their own minimum.

        Raises ConfigurationError when they have no range in common.
        """
        time_grid = max(self, other, key=lambda limits: limits.time_step_us)
        gain_grid = max(self, other, key=lambda limits: limits.gain_step_db)
        min_gain_db, max_gain_db = max(self.min_gain_db, other.min_gain_db), min(self.max_gain_db, other.max_gain_db)
        tables = [table for table in (self.gains_db, other.gains_db) if table]
        inside = [_within(table, min_gain_db, max_gain_db) for table in tables]
        gains_db = min(inside, key=len, default=())
        if tables and not gains_db and min_gain_db <= max_gain_db:
            table = tables[inside.index(())]
            nearest = sorted(table, key=lambda gain_db: max(min_gain_db - gain_db, gain_db - max_gain_db))[:2]
            raise ConfigurationError(
                f"gain limits {min_gain_db:g} to {max_gain_db:g} dB leave none of the gains that the camera has: the "
                f"nearest are {' and '.join(f'{gain_db:g}' for gain_db in sorted(nearest))} dB"
            )
        if not tables:
            min_gain_db = _next_on_grid(min_gain_db, gain_grid.min_gain_db, gain_grid.gain_step_db)
        return ExposureLimits(
            _next_on_grid(max(self.min_time_us, other.min_time_us), time_grid.min_time_us, time_grid.time_step_us),
            min(self.max_time_us, other.max_time_us),
            gains_db[0] if gains_db else min_gain_db,
            gains_db[-1] if gains_db else max_gain_db,
            time_grid.time_step_us,
            gain_grid.gain_step_db,
            gains_db,
        )

    def realise(self, level: float, exposure_time_us: float) -> ExposureSetting:
        """The setting within limits and increments whose level is nearest to `level`, its time near `exposure_time_us`.

        What the time cannot provide, because of a bound or an increment, goes to the gain; what the gain cannot
        provide goes back to the time.
        """
        level = self.clamp_level(level)
        gain_db = self._gain_for(level, min(max(exposure_time_us, self.min_time_us), self.max_time_us))
        settings = [
            ExposureSetting(time_us, self._gain_for(level, time_us))
            for time_us in self._neighbours_us(exp2(level - gain_db / DB_PER_STOP))
        ]
        return min(settings, key=lambda setting: abs(setting.level - level))

    def _neighbours_us(self, exposure_time_us: float) -> tuple[float, ...]:
        """The exposure times that the camera can take just below and just above a wanted one."""
        if self.time_step_us <= 0:
            return (min(max(exposure_time_us, self.min_time_us), self.max_time_us),)
        steps = (exposure_time_us - self.min_time_us) / self.time_step_us
        return tuple(
            _quantise(self.min_time_us + n * self.time_step_us, self.min_time_us, self.max_time_us, self.time_step_us)
            for n in (math.floor(steps + 1e-6), math.ceil(steps - 1e-6))
        )

    def _gain_for(self, level: float, exposure_time_us: float) -> float:
        gain_db = (level - math.log2(exposure_time_us)) * DB_PER_STOP
        if not self.gains_db:
            return _quantise(gain_db, self.min_gain_db, self.max_gain_db, self.gain_step_db)
        # The nearest of the gains that it takes whose difference the time can make up for.
        longest_db = math.log2(self.max_time_us / exposure_time_us) * DB_PER_STOP
        shortest_db = math.log2(self.min_time_us / exposure_time_us) * DB_PER_STOP

        def key(taken_db: float) -> tuple[float, float]:
            missing_db = gain_db - taken_db
            return round(max(missing_db - longest_db, shortest_db - missing_db, 0.0), 6), abs(missing_db)

        above = bisect(self.gains_db, gain_db)
        return min(self.gains_db[max(above - 1, 0) : above + 1], key=key)


def _within(gains_db: tuple[float, ...], low_db: float, high_db: float) -> tuple[float, ...]:
    """Those of some gains within bounds, or so little beyond that a setting at the bound agrees with them."""
    near = (gain_db for gain_db in gains_db if low_db - SAME_GAIN_DB < gain_db < high_db + SAME_GAIN_DB)
    return tuple(min(max(gain_db, low_db), high_db) for gain_db in near)


def _quantise(value: float, low: float, high: float, step: float) -> float:
    """The value of the grid ``low + n * step`` within [low, high] that is nearest to `value`."""
    value = min(max(value, low), high)
    if step <= 0:
        return value
    steps = min(round((value - low) / step), math.floor((high - low) / step + 1e-9))
    return min(low + steps * step, high)  # the product may round to just above the bound


def _next_on_grid(value: float, origin: float, step: float) -> float:
    """The value of the grid ``origin + n * step`` at or just above `value`."""
    return origin + math.ceil((value - origin) / step - 1e-9) * step if step > 0 else value
