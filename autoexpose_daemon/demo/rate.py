"""The rate that the demo can run at, so that the simulation loses no frames on a slow machine."""

from __future__ import annotations

import os
from pathlib import Path

RATES_HZ = (60.0, 30.0, 20.0, 10.0, 4.0, 2.0)
"""The demo runs at the highest that this machine can sustain.

Not at 5 Hz: over USB3 Vision Aravis 0.8.26 waits 0.2 s at a time for a frame, and may lose one that arrives between
two waits (docs/usb3.md).
"""

_USABLE_SHARE = 0.85  # of the cores; the rest is for the terminal and the system
_SENDING_S = 0.001  # a fake camera's time per frame apart from rendering: packets, clock, commands
_DAEMON_S = 0.0085  # the daemon's time for a pair: half a core at 60 Hz, as measured on a slow machine
_MEASURED_AT_BYTES = 720 * 540
_QUOTA = Path("/sys/fs/cgroup/cpu.max")


def cores(quota: Path = _QUOTA) -> float:
    """How many cores this process may use, by its affinity and its container's quota (cgroup v2)."""
    allowed = len(os.sched_getaffinity(0))
    try:
        share, period = quota.read_text().split()
        return allowed if share == "max" else min(allowed, int(share) / int(period))
    except (OSError, ValueError, ZeroDivisionError):
        return allowed


def pairs_per_s(frame_s: float, cores: float, image_bytes: int = _MEASURED_AT_BYTES) -> float:
    """Pairs per second that two fake cameras, which need `frame_s` per frame, can make beside the daemon.

    The time that sending and the daemon take is assumed to grow with a frame's `image_bytes`.
    """
    size = image_bytes / _MEASURED_AT_BYTES
    camera_s = frame_s + size * _SENDING_S
    return _USABLE_SHARE * min(cores / (2 * camera_s + size * _DAEMON_S), 1 / camera_s)


def held_rate_hz(possible_hz: float) -> float:
    """The highest rate that can be sustained, or the lowest of all."""
    return next((rate_hz for rate_hz in RATES_HZ if rate_hz <= possible_hz), RATES_HZ[-1])


def shortfall(possible_hz: float, rate_hz: float, asked: bool) -> str | None:
    """What to say before the first frame if the machine is too slow, else None."""
    renders = f"this machine renders {possible_hz:.0f} frames a second"
    if rate_hz > possible_hz:
        return f"{renders}: at {rate_hz:g} Hz the fake cameras will lose some"
    return f"{renders}: showing {rate_hz:g} Hz" if not asked and rate_hz < RATES_HZ[0] else None
