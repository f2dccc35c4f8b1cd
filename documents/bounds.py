"""Bounds of configured numbers and names: beyond them a value is a typo, whatever the camera."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TypeVar

from documents.text import quoted

N = TypeVar("N", int, float)

CAMERA_NAME = re.compile(r"(?!(?:consumers|both|several)$)[a-z][a-z0-9_]{0,63}")
"""What the cameras of a configuration may be called; `consumers` stands in the same place of other keys, and `both` and
`several` in that of reasons why a trigger made no whole set."""


@dataclass(frozen=True, slots=True)
class Range:
    """Numbers from `low` to `high`, both included."""

    low: float
    high: float
    unit: str = ""

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def __str__(self) -> str:
        return f"{self.low:.10g} to {self.high:.10g} {self.unit}".rstrip()

    def check(self, value: N) -> N:
        """The value itself; raises ValueError if it is out of range or NaN."""
        if value not in self:
            raise ValueError(f"{quoted(value)} is out of bounds: give {self}")
        return value


RATE_HZ = Range(0.1, 1000.0, "Hz")
PHASE_MS = Range(0.0, 1000.0, "ms")
EXPOSURE_TIME_US = Range(0.1, 10_000_000.0, "us")
EXPOSURE_COUNT_US = Range(0.001, 10_000.0, "us")
GAIN_DB = Range(-60.0, 100.0, "dB")
OFFSET_STOPS = Range(-8.0, 8.0, "stops")
EV_STOPS = Range(-3.0, 3.0, "stops")
WEIGHT = Range(0.0, 1.0)
PIXEL = Range(0, 65_535, "pixels")
EXTENT = Range(1, 65_536, "pixels")
BINNING = Range(1, 8, "pixels")
LINK_MBPS = Range(10.0, 100_000.0, "Mb/s")
PACKET_BYTES = Range(576, 16_000, "bytes")
UTC_OFFSET_S = Range(0, 100, "s")
SAMPLE_AGE_S = Range(0.001, 10.0, "s")
