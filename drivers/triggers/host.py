"""Triggers that the host gives, and frames that are placed by their arrival."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace

from drivers.ptp import Synchronisation
from drivers.rig.events import CameraGone, CameraReady, ClockRead, FrameArrived, RigEvent
from drivers.rig.supervision import Slots
from imaging.frames import Frame, Side, StereoPair


class HostTriggers:
    """No triggers by the host: the cameras are triggered by a wire, or run freely. Times are CLOCK_MONOTONIC, in ns."""

    def see(self, _event: RigEvent, _now_ns: int) -> Mapping[Side, Slots]:
        """Look at an event; returns the slots in which to trigger cameras from now on."""
        return {}

    def placed(self, event: RigEvent) -> RigEvent:
        """The event, with the best time that is known for its frame."""
        return event

    def trouble(self, _side: Side, _now_ns: int) -> str | None:
        """What keeps a camera from being triggered as it should, in words; None: nothing."""
        return None

    def skew_ns(self, pair: StereoPair) -> int:
        """How far apart the exposures of a pair began."""
        return _apart_ns([frame.host_time_ns for frame in pair.frames.values()])


class SoftwareTriggers(HostTriggers):
    """Triggers given by a command at the time of each slot."""

    def __init__(self, rate_hz: float, first_ns: int) -> None:
        self._slots = Slots.at_once(rate_hz, first_ns)

    def see(self, event: RigEvent, _now_ns: int) -> Mapping[Side, Slots]:
        """A camera that is ready is triggered."""
        return {event.side: self._slots} if isinstance(event, CameraReady) else {}


class PtpTriggers(HostTriggers):
    """Triggers scheduled on the clock that the cameras share."""

    def __init__(self, rate_hz: float) -> None:
        self._sync = Synchronisation(rate_hz)

    def see(self, event: RigEvent, now_ns: int) -> Mapping[Side, Slots]:
        """Cameras are triggered from when they are synchronised."""
        match event:
            case CameraReady(side, description):
                self._sync.ready(side, description.action_queue, now_ns)
            case CameraGone(side):
                self._sync.gone(side)
            case ClockRead(side, reading):
                return self._sync.read(side, reading, now_ns)
        return {}

    def placed(self, event: RigEvent) -> RigEvent:
        """Frames of cameras that are synchronised get their time from the common clock."""
        match event:
            case FrameArrived(side, Frame() as frame, stale):
                return FrameArrived(side, replace(frame, host_time_ns=self._sync.common_ns(side, frame)), stale)
        return event

    def trouble(self, side: Side, now_ns: int) -> str | None:
        """Why a camera is not synchronised."""
        return self._sync.trouble(side, now_ns)

    def skew_ns(self, pair: StereoPair) -> int:
        """By the cameras' own time stamps if they are of one clock: as exact as that clock is kept."""
        if not self._sync.is_common(pair.frames):
            return super().skew_ns(pair)
        return _apart_ns([frame.device_time_ns for frame in pair.frames.values()])


def _apart_ns(times_ns: list[int]) -> int:
    return max(times_ns) - min(times_ns)


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
