"""Whether stamps of PTP time are the time that others on the robot go by: a matter of 37 seconds."""

from __future__ import annotations

import logging

from autoexpose_daemon.messages.frames import Stamping

log = logging.getLogger(__name__)

FAR_S = 1.0
"""Clocks of one robot that are further apart do not show one time."""
TAI_AHEAD_S = 37
"""Of UTC, since 2017. IEEE 1588 has masters give TAI, but many are set to UTC."""


class StampWatch:
    """Says how stamps of PTP time lie to the computer's clock: at the first look, and when that has changed."""

    def __init__(self, stamping: Stamping) -> None:
        self._utc_offset_s = stamping.ptp_utc_offset_s
        self._said_s: float | None = None

    def look(self, ptp_ns: int, realtime_ns: int) -> None:
        """What PTP time and CLOCK_REALTIME are at one moment."""
        if self._utc_offset_s is None:
            return
        ahead_s = (ptp_ns - realtime_ns) * 1e-9 - self._utc_offset_s
        if self._said_s is not None and abs(ahead_s - self._said_s) < FAR_S:
            return
        self._said_s = ahead_s
        stamps = f"stamps are PTP time less {self._utc_offset_s} s: {ahead_s:+.4g} s by this computer's clock"
        if abs(ahead_s) < FAR_S:
            log.info("%s", stamps)
        else:
            log.warning("%s: %s", stamps, self._advice(ahead_s))

    def _advice(self, ahead_s: float) -> str:
        assert self._utc_offset_s is not None
        for scale, fitting_s in (("UTC", 0), ("TAI", TAI_AHEAD_S)):
            if abs(ahead_s + self._utc_offset_s - fitting_s) < FAR_S:
                return f"the master seems to give {scale}, so set publish.ptp_utc_offset_s: {fitting_s}"
        return "others on this computer stamp by its clock: set it by PTP as well, or mind the master's time"
