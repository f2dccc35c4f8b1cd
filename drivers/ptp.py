"""Cameras whose clocks are kept at one time by IEEE 1588, the Precision Time Protocol (PTP)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.camera import ClockReading, PtpState
from drivers.genicam.nodes import NodeMap, switch
from drivers.genicam.trigger import PTP_SWITCHES
from drivers.rig.supervision import Slots
from imaging.errors import UnsupportedCameraError
from imaging.frames import SIDES, Frame, Side

_LATCH_NODES = ("PtpDataSetLatch", "GevIEEE1588DataSetLatch")
_STATUS_NODES = ("PtpStatus", "GevIEEE1588StatusLatched", "GevIEEE1588Status")
_OFFSET_NODES = ("PtpOffsetFromMaster", "GevIEEE1588OffsetFromMasterLatched", "GevIEEE1588OffsetFromMaster")
"""Each by its SFNC name, then by those of older descriptions."""


class PtpNodes:
    """The PTP clock of a camera, switched on.

    Raises
    ------
    UnsupportedCameraError
        At construction, when the camera has none, or one without a status.
    """

    def __init__(self, nodes: NodeMap) -> None:
        self._nodes = nodes
        switch(nodes, self._required(PTP_SWITCHES), True)
        self._status = self._required(_STATUS_NODES)
        self._latch = self._first(_LATCH_NODES)
        self._offset = self._first(_OFFSET_NODES)

    @property
    def limitations(self) -> tuple[str, ...]:
        """What it cannot do, in words."""
        if self._offset is None:
            return (f"no {_OFFSET_NODES[0]}: how far its clock is from its master's is not known",)
        return ()

    def read(self) -> PtpState:
        """How its clock is synchronised now."""
        if self._latch is not None:
            self._nodes.execute(self._latch)
        offset_ns = None if self._offset is None else self._nodes.read_integer(self._offset)
        if offset_ns is not None and offset_ns >= 1 << 63:  # some descriptions forget its sign
            offset_ns -= 1 << 64
        return PtpState(self._nodes.read_entry(self._status), offset_ns)

    def _first(self, names: tuple[str, ...]) -> str | None:
        return next((name for name in names if self._nodes.available(name)), None)

    def _required(self, names: tuple[str, ...]) -> str:
        name = self._first(names)
        if name is None:
            raise UnsupportedCameraError(
                f"camera {self._nodes.serial}: it has no {' or '.join(names)}, and so no clock that PTP synchronises: "
                "choose another trigger.mode"
            )
        return name


SYNCHRONISED_NS = 100_000
"""A clock this close to its master's is synchronised,"""
LOST_NS = 1_000_000
"""and stays so up to here."""
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
    """Follows the clocks of a rig's cameras. Times are CLOCK_MONOTONIC, in ns, unless they are of PTP or a camera."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._clocks: dict[Side, _Clock] = {}
        self._first_ns: int | None = None  # slot 0, in PTP time; None: triggers have not begun
        self._offset_ns = 0  # host time minus PTP time
        self._reference: Side | None = None  # whose clock shows PTP time at present

    def ready(self, side: Side, queue: int, now_ns: int) -> None:
        """A camera is open, and keeps up to `queue` scheduled triggers."""
        self._clocks[side] = _Clock(queue, now_ns)

    def gone(self, side: Side) -> None:
        """A camera is lost."""
        self._clocks.pop(side, None)

    def read(self, side: Side, reading: ClockReading, now_ns: int) -> Mapping[Side, Slots]:
        """Note what a camera says; returns the slots in which to trigger each camera from now on."""
        clock = self._clocks.get(side)
        if clock is None:  # it was lost meanwhile
            return {}
        clock.read(reading, now_ns)
        self._track(now_ns)
        if self._first_ns is None:
            return {}
        return {side: self._slots(clock, self._first_ns) for side, clock in self._clocks.items() if clock.ever}

    def trouble(self, side: Side, now_ns: int) -> str | None:
        """Why a camera is not synchronised, and what to do, in words; None: it is, or has not had time yet."""
        clock = self._clocks.get(side)
        if clock is None or clock.reading is None:
            return None
        if clock.synchronised:
            if self._first_ns is None or self._in_time(clock):
                return None
            apart_s = abs(clock.offset_ns - self._offset_ns) / _NS_PER_S
            return f"its clock is {apart_s:.1f} s off the other camera's: have both follow one PTP master"
        if clock.ever:
            return "its clock is no longer synchronised: check the PTP master, and the way to it"
        return _waited(clock.reading.ptp.status) if now_ns - clock.since_ns >= PATIENCE_NS else None

    def common_ns(self, side: Side, frame: Frame) -> int:
        """When a frame was taken: by the common clock if its camera is synchronised, else by the camera's own."""
        clock = self._clocks.get(side)
        common_ns = frame.device_time_ns + self._offset_ns
        if clock is None or not self._in_time(clock) or abs(common_ns - frame.host_time_ns) > STEP_NS:
            return frame.host_time_ns
        return common_ns

    def is_common(self, sides: Mapping[Side, Frame]) -> bool:
        """Whether the clocks of these cameras show one time at present."""
        return all(side in self._clocks and self._in_time(self._clocks[side]) for side in sides)

    def _in_time(self, clock: _Clock) -> bool:
        return clock.synchronised and abs(clock.offset_ns - self._offset_ns) <= STEP_NS

    def _track(self, now_ns: int) -> None:
        """Follow PTP time. When it was set, or is back, slots go on where they are; only their PTP times change."""
        synchronised = [side for side in SIDES if side in self._clocks and self._clocks[side].synchronised]
        if not synchronised:
            self._reference = None
            return
        back = self._reference is None
        if self._reference not in synchronised:
            self._reference = synchronised[0]
        offset_ns = self._clocks[self._reference].offset_ns
        if self._first_ns is None:
            waiting = len(synchronised) < len(self._clocks)
            if waiting and now_ns - min(clock.since_ns for clock in self._clocks.values()) < PATIENCE_NS:
                return
            self._first_ns = -(-(now_ns - offset_ns) // _NS_PER_S) * _NS_PER_S  # a whole second
        elif back or abs(offset_ns - self._offset_ns) > STEP_NS:
            self._first_ns += self._offset_ns - offset_ns
        self._offset_ns = offset_ns

    def _slots(self, clock: _Clock, first_ns: int) -> Slots:
        host_first_ns = first_ns + self._offset_ns
        device_first_ns = first_ns if self._in_time(clock) else host_first_ns - clock.offset_ns
        return Slots.ahead(self._rate_hz, host_first_ns, device_first_ns, clock.queue)


def _waited(status: str) -> str:
    """What is wrong with a clock that was not synchronised in time."""
    waited = f"{PATIENCE_NS / _NS_PER_S:g} s (PtpStatus {status})"
    if status in _MASTER_FOUND:
        near = f"{SYNCHRONISED_NS / 1000:g} us"
        return f"its clock is not within {near} of its PTP master's after {waited}: check the way to it"
    return f"its clock found no PTP master within {waited}: start one, and check that the switch passes PTP on"
