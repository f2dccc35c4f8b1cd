"""Which moment of its exposure a frame is stamped with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from imaging.frames import Frame

Stamp = Literal["start", "middle", "end"]

_SHARES: dict[Stamp, float] = {"start": 0.0, "middle": 0.5, "end": 1.0}


def moment_ns(frame: Frame, stamp: Stamp) -> int:
    """That moment, CLOCK_MONOTONIC. A moving object is seen where it is in the middle of the exposure."""
    return frame.host_time_ns + round(1e3 * _SHARES[stamp] * frame.setting.exposure_time_us)
