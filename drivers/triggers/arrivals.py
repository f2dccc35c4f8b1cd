"""Frames that are placed by their arrival, beside those of a camera whose clock is known."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from drivers.rig.events import CameraGone, FrameArrived, RigEvent
from imaging.frames import Frame, Side

COMPARED_FRAMES = 60
"""The quickest of so many took as long as readout and transfer do."""


class ReadoutTimes:
    """How long readout and transfer take is known of a camera whose clock is; another one's is taken to be the same.

    So frames that are placed by their arrival pair with those of a camera that stamps them.
    """

    def __init__(self) -> None:
        self._known_ns: dict[Side, deque[int]] = {}

    def placed(self, event: RigEvent) -> RigEvent:
        """The event, with the time at which its frame is likely to have been taken."""
        match event:
            case FrameArrived(side, Frame(by_arrival=False) as frame):
                known_ns = self._known_ns.setdefault(side, deque(maxlen=COMPARED_FRAMES))
                known_ns.append(
                    frame.arrival_time_ns - frame.host_time_ns - round(1e3 * frame.setting.exposure_time_us)
                )
            case FrameArrived(side, Frame() as frame, stale):
                readout_ns = min((min(known_ns) for known_ns in self._known_ns.values()), default=0)
                return FrameArrived(side, replace(frame, host_time_ns=frame.host_time_ns - readout_ns), stale)
            case CameraGone(side):
                self._known_ns.pop(side, None)
        return event
