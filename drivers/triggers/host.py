"""Triggers that the host gives, the clocks (IEEE 1588) that it gives them by, and frames placed by their arrival."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from drivers.camera import ClockReading
from drivers.rig.events import CameraGone, CameraReady, ClockRead, FrameArrived, RigEvent
from drivers.rig.supervision import Slots
from drivers.triggers.phase import Grid, Phase
from imaging.frames import CameraName, Frame, FrameSet

SYNCHRONISED_NS = 100_000
"""A clock this close to its master's is synchronised."""
LOST_NS = 1_000_000
"""One that was synchronised stays so up to here."""
GOOD_READINGS = 2
"""A second apart. The first may have been taken while the clock was being set."""
STEP_NS = 5_000_000
"""Beyond any error in reading a clock: two this far apart show different times, and one that moves this far was set."""
PATIENCE_NS = 10_000_000_000
"""A camera finds its master within some seconds."""
FOLLOWING = ("Slave", "Master")
_MASTER_FOUND = ("Slave", "Uncalibrated")
_NS_PER_S = 1_000_000_000


@dataclass(slots=True)
class _Clock:
    """What is known of an open camera's clock; `since_ns`: since when it should have been synchronised."""

    queue: int
    since_ns: int
    reading: ClockReading | None = None
    good: int = 0
    synchronised: bool = False
    ever: bool = False

    def read(self, reading: ClockReading, now_ns: int) -> None:
        found = reading.ptp.status in _MASTER_FOUND
        if found and self.reading is not None and self.reading.ptp.status not in _MASTER_FOUND:
            self.since_ns = now_ns
        self.reading = reading
        off_ns = abs(reading.ptp.offset_ns or 0) if reading.ptp.status == "Slave" else 0  # a master's means nothing
        fine = reading.ptp.status in FOLLOWING and off_ns <= (LOST_NS if self.synchronised else SYNCHRONISED_NS)
        self.good = self.good + 1 if fine else 0
        if self.synchronised and not fine:
            self.since_ns = now_ns
        self.synchronised = fine and (self.synchronised or self.good >= GOOD_READINGS)
        self.ever = self.ever or self.synchronised

    @property
    def offset_ns(self) -> int:
        """Host time minus its time, at the last reading."""
        return 0 if self.reading is None else self.reading.host_offset_ns


class Synchronisation:
    """Follows the clocks of a rig's cameras. Times are CLOCK_MONOTONIC, in ns, unless they are of PTP or a camera.

    Triggers keep `phase_ns` after whole seconds of PTP time; with None they begin with one, and keep to no phase.
    """

    def __init__(self, rate_hz: float, phase_ns: int | None = None) -> None:
        self._rate_hz = rate_hz
        self._phase = Phase(rate_hz, phase_ns or 0)
        self._keeps_phase = phase_ns is not None
        self._clocks: dict[CameraName, _Clock] = {}
        self._grid: Grid | None = None  # of slots, in PTP time; None: triggers have not begun
        self._offset_ns = 0  # host time minus PTP time
        self._reference: CameraName | None = None  # whose clock shows PTP time at present

    def ready(self, camera: CameraName, queue: int, now_ns: int) -> None:
        """A camera is open, and keeps up to `queue` scheduled triggers."""
        self._clocks[camera] = _Clock(queue, now_ns)

    def gone(self, camera: CameraName) -> None:
        """A camera is lost."""
        self._clocks.pop(camera, None)

    def read(self, camera: CameraName, reading: ClockReading, now_ns: int) -> Mapping[CameraName, Slots]:
        """Note what a camera says; returns the slots in which to trigger each camera from now on."""
        clock = self._clocks.get(camera)
        if clock is None:  # it was lost meanwhile
            return {}
        clock.read(reading, now_ns)
        self._track(now_ns)
        if self._grid is None:
            return {}
        return {camera: self._slots(clock, self._grid) for camera, clock in self._clocks.items() if clock.ever}

    def trouble(self, camera: CameraName, now_ns: int) -> str | None:
        """Why a camera is not synchronised, and what to do, in words; None: it is, or has not had time yet."""
        clock = self._clocks.get(camera)
        if clock is None or clock.reading is None:
            return None
        if clock.synchronised:
            if self._grid is None or self._in_time(clock):
                return None
            apart_s = abs(clock.offset_ns - self._offset_ns) / _NS_PER_S
            return f"its clock is {apart_s:.1f} s off that of the other cameras: have all follow one PTP master"
        if clock.ever:
            return "its clock is no longer synchronised: check the PTP master, and the way to it"
        return _waited(clock.reading.ptp.status) if now_ns - clock.since_ns >= PATIENCE_NS else None

    def common_ns(self, camera: CameraName, frame: Frame) -> int:
        """When a frame was taken: by the common clock if its camera is synchronised, else by the camera's own."""
        clock = self._clocks.get(camera)
        common_ns = frame.device_time_ns + self._offset_ns
        if clock is None or not self._in_time(clock) or abs(common_ns - frame.host_time_ns) > STEP_NS:
            return frame.host_time_ns
        return common_ns

    def ptp_time_ns(self, host_time_ns: int) -> int | None:
        """What PTP time is then: as last seen, while no clock is synchronised; None before one was."""
        return None if self._grid is None else host_time_ns - self._offset_ns

    def is_common(self, cameras: Mapping[CameraName, Frame]) -> bool:
        """Whether the clocks of these cameras show one time at present."""
        return all(camera in self._clocks and self._in_time(self._clocks[camera]) for camera in cameras)

    def _in_time(self, clock: _Clock) -> bool:
        return clock.synchronised and abs(clock.offset_ns - self._offset_ns) <= STEP_NS

    def _track(self, now_ns: int) -> None:
        """Follow PTP time. When it was set, or is back, slots go on where they are; only their PTP times change.

        If they are to keep a phase, they come nearer to it with each reading.
        """
        synchronised = [camera for camera, clock in self._clocks.items() if clock.synchronised]
        if synchronised:
            self._follow(synchronised, now_ns)
        else:
            self._reference = None
        if self._grid is not None and self._keeps_phase:
            self._grid = self._phase.approached(self._grid, now_ns - self._offset_ns)

    def _follow(self, synchronised: list[CameraName], now_ns: int) -> None:
        back = self._reference is None
        if self._reference not in synchronised:
            self._reference = synchronised[0]
        offset_ns = self._clocks[self._reference].offset_ns
        if self._grid is None:
            waiting = len(synchronised) < len(self._clocks)
            if waiting and now_ns - min(clock.since_ns for clock in self._clocks.values()) < PATIENCE_NS:
                return
            self._grid = self._phase.begun(now_ns - offset_ns)
        elif back or abs(offset_ns - self._offset_ns) > STEP_NS:
            self._grid = self._grid.shown_by(self._offset_ns - offset_ns)
        self._offset_ns = offset_ns

    def _slots(self, clock: _Clock, grid: Grid) -> Slots:
        host_first_ns = grid.first_ns + self._offset_ns
        device_first_ns = grid.first_ns if self._in_time(clock) else host_first_ns - clock.offset_ns
        slots = Slots.ahead(self._rate_hz, host_first_ns, device_first_ns, clock.queue)
        return replace(slots, period_ns=grid.period_ns)


def _waited(status: str) -> str:
    """What is wrong with a clock that was not synchronised in time."""
    waited = f"{PATIENCE_NS / _NS_PER_S:g} s (PtpStatus {status})"
    if status in _MASTER_FOUND:
        near = f"{SYNCHRONISED_NS / 1000:g} us"
        return f"its clock is not within {near} of its PTP master's after {waited}: check the way to it"
    return f"its clock found no PTP master within {waited}: start one, and check that the switch passes PTP on"


class HostTriggers:
    """No triggers by the host: the cameras are triggered by a wire, or run freely. Times are CLOCK_MONOTONIC, in ns."""

    def see(self, _event: RigEvent, _now_ns: int) -> Mapping[CameraName, Slots]:
        """Look at an event; returns the slots in which to trigger cameras from now on."""
        return {}

    def placed(self, event: RigEvent) -> RigEvent:
        """The event, with the best time that is known for its frame."""
        return event

    def ptp_time_ns(self, _host_time_ns: int) -> int | None:
        """What PTP time is then; None: nobody knows."""
        return None

    def trouble(self, _side: CameraName, _now_ns: int) -> str | None:
        """What keeps a camera from being triggered as it should, in words; None: nothing."""
        return None

    def skew_ns(self, pair: FrameSet) -> int:
        """How far apart the exposures of a pair began."""
        return _apart_ns([frame.host_time_ns for frame in pair.frames.values()])


class SoftwareTriggers(HostTriggers):
    """Triggers given by a command at the time of each slot."""

    def __init__(self, rate_hz: float, first_ns: int) -> None:
        self._slots = Slots.at_once(rate_hz, first_ns)

    def see(self, event: RigEvent, _now_ns: int) -> Mapping[CameraName, Slots]:
        """A camera that is ready is triggered."""
        return {event.camera: self._slots} if isinstance(event, CameraReady) else {}


class PhasedSoftwareTriggers(SoftwareTriggers):
    """The same, `phase_ns` after whole seconds of the host's clock; `realtime_offset_ns` returns what that is ahead of
    CLOCK_MONOTONIC, which changes when somebody sets it."""

    def __init__(self, rate_hz: float, now_ns: int, phase_ns: int, realtime_offset_ns: Callable[[], int]) -> None:
        self._phase = Phase(rate_hz, phase_ns)
        self._realtime_offset_ns = realtime_offset_ns
        offset_ns = realtime_offset_ns()
        self._grid = self._phase.begun(now_ns + offset_ns).shown_by(-offset_ns)
        super().__init__(rate_hz, self._grid.first_ns)
        self._open: set[CameraName] = set()
        self._look_ns = now_ns

    def see(self, event: RigEvent, now_ns: int) -> Mapping[CameraName, Slots]:
        """Once a second, with any event, the host's clock is looked at."""
        match event:
            case CameraReady(camera):
                self._open.add(camera)
            case CameraGone(camera):
                self._open.discard(camera)
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + _NS_PER_S
            offset_ns = self._realtime_offset_ns()
            grid = self._phase.approached(self._grid.shown_by(offset_ns), now_ns + offset_ns).shown_by(-offset_ns)
            if grid != self._grid:
                self._grid = grid
                self._slots = replace(self._slots, first_ns=grid.first_ns, period_ns=grid.period_ns)
                return dict.fromkeys(self._open, self._slots)
        return super().see(event, now_ns)


class PtpTriggers(HostTriggers):
    """Triggers scheduled on the clock that the cameras share; `phase_ns` as `Synchronisation` has it."""

    def __init__(self, rate_hz: float, phase_ns: int | None = None) -> None:
        self._sync = Synchronisation(rate_hz, phase_ns)

    def see(self, event: RigEvent, now_ns: int) -> Mapping[CameraName, Slots]:
        """Cameras are triggered from when they are synchronised."""
        match event:
            case CameraReady(camera, description):
                self._sync.ready(camera, description.action_queue, now_ns)
            case CameraGone(camera):
                self._sync.gone(camera)
            case ClockRead(camera, reading):
                return self._sync.read(camera, reading, now_ns)
        return {}

    def placed(self, event: RigEvent) -> RigEvent:
        """Frames of cameras that are synchronised get their time from the common clock."""
        match event:
            case FrameArrived(camera, Frame() as frame, stale):
                host_time_ns = self._sync.common_ns(camera, frame)
                ptp_time_ns = self.ptp_time_ns(host_time_ns)
                return FrameArrived(camera, replace(frame, host_time_ns=host_time_ns, ptp_time_ns=ptp_time_ns), stale)
        return event

    def ptp_time_ns(self, host_time_ns: int) -> int | None:
        """By a clock that is synchronised; as last seen, while there is none."""
        return self._sync.ptp_time_ns(host_time_ns)

    def trouble(self, camera: CameraName, now_ns: int) -> str | None:
        """Why a camera is not synchronised."""
        return self._sync.trouble(camera, now_ns)

    def skew_ns(self, pair: FrameSet) -> int:
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
        self._known_ns: dict[CameraName, deque[int]] = {}

    def placed(self, event: RigEvent) -> RigEvent:
        """The event, with the time at which its frame is likely to have been taken."""
        match event:
            case FrameArrived(camera, Frame(by_arrival=False) as frame):
                known_ns = self._known_ns.setdefault(camera, deque(maxlen=COMPARED_FRAMES))
                known_ns.append(
                    frame.arrival_time_ns - frame.host_time_ns - round(1e3 * frame.setting.exposure_time_us)
                )
            case FrameArrived(camera, Frame() as frame, stale):
                readout_ns = min((min(known_ns) for known_ns in self._known_ns.values()), default=0)
                return FrameArrived(camera, replace(frame, host_time_ns=frame.host_time_ns - readout_ns), stale)
            case CameraGone(camera):
                self._known_ns.pop(camera, None)
        return event
