"""Exposure and metric of every pair in the last minutes, in few enough numbers to draw."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from typing import Any

from autoexpose_daemon.control.decision import Decision
from imaging.exposure import ExposureSetting

BUCKET_S = 0.5
"""Finer than a pixel of the chart; each bucket keeps its least and greatest value, so no spike is lost."""

LENGTH_S = 300.0

SERIES = (
    "exposure_time_us", "gain_db", "level", "metric", "asked_time_us", "asked_gain_db", "asked_level",
)  # fmt: skip
"""The columns of a row: what pairs were taken with and measured, and what was requested."""

Range = tuple[float, float] | None
"""The least and the greatest value; None without any."""


class _Bucket:
    """Half a second."""

    def __init__(self, start_s: float) -> None:
        self.start_s = start_s
        self.ranges: list[Range] = [None] * len(SERIES)

    def add(self, values: Sequence[float | None]) -> None:
        """Widen the ranges by one value of each series."""
        for column, value in enumerate(values):
            if value is not None and math.isfinite(value):
                low, high = self.ranges[column] or (value, value)
                self.ranges[column] = min(low, value), max(high, value)


class History:
    """Rows of the last five minutes, oldest first. Any thread may add or read."""

    def __init__(self) -> None:
        self._rows: deque[_Bucket] = deque(maxlen=round(LENGTH_S / BUCKET_S))
        self._lock = threading.Lock()

    def add(self, now_s: float, applied: ExposureSetting, decision: Decision | None) -> None:
        """Add the setting of a pair and the decision on it; `now_s` is from CLOCK_MONOTONIC."""
        asked = None if decision is None else decision.setting
        values = (
            applied.exposure_time_us,
            applied.gain_db,
            applied.level,
            None if decision is None else decision.metric,
            None if asked is None else asked.exposure_time_us,
            None if asked is None else asked.gain_db,
            None if asked is None else asked.level,
        )
        start_s = math.floor(now_s / BUCKET_S) * BUCKET_S
        with self._lock:
            if not self._rows or self._rows[-1].start_s < start_s:
                self._rows.append(_Bucket(start_s))
            self._rows[-1].add(values)

    def since(self, time_s: float) -> list[tuple[Any, ...]]:
        """Rows from `time_s` on: time (s), then the range of each of `SERIES`. The newest may still change."""
        with self._lock:
            return [(row.start_s, *row.ranges) for row in self._rows if row.start_s >= time_s]
