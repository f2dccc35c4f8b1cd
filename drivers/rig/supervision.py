"""Keeping one camera alive: open it, trigger it, write to it, check that it answers, close it and open it again."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import Camera
from drivers.log_throttle import LogThrottle
from drivers.rig.events import (
    OPENING,
    CameraGone,
    CameraReady,
    CameraSilent,
    ClockRead,
    EventQueue,
    FrameArrived,
    NotTriggered,
    PacketsRefused,
    TemperatureRead,
    WriteFailed,
    Written,
)
from imaging.errors import AutoexposeError, CameraError, CameraLostError, stays
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame

log = logging.getLogger(__name__)

LATE_PERIODS = 0.2
"""A trigger that would be later than this is not given: a frame further off the grid might be paired with another
instant's."""

LEAD_NS = 50_000_000
"""A scheduled trigger is sent this long before its time, which survives most pauses of a busy host."""
LEAD_PERIODS = 0.9
"""At high rates it waits until so much of a period is left before one more would overfill the camera's queue."""
LAST_MOMENT_NS = 2_000_000
"""One that is not sent this long before its time might not arrive in time."""


@dataclass(frozen=True, slots=True)
class Slots:
    """Slot n is `n * period_ns` after `first_ns` (CLOCK_MONOTONIC).

    Its trigger is given between `opens_ns` and `closes_ns` after it, which may be negative: scheduled, for the time of
    the slot on the camera's clock, where slot 0 is at `device_first_ns`; or, if that is None, at once.
    """

    first_ns: int
    period_ns: float
    opens_ns: int
    closes_ns: int
    device_first_ns: int | None = None

    @classmethod
    def at_once(cls, rate_hz: float, first_ns: int) -> Slots:
        """Slots of triggers that act when they are given."""
        period_ns = 1e9 / rate_hz
        return cls(first_ns, period_ns, 0, round(LATE_PERIODS * period_ns))

    @classmethod
    def ahead(cls, rate_hz: float, first_ns: int, device_first_ns: int, queue: int) -> Slots:
        """Slots of triggers that are scheduled at a camera which keeps up to `queue` of them."""
        period_ns = 1e9 / rate_hz
        lead_ns = min(LEAD_NS, round((queue - 1 + LEAD_PERIODS) * period_ns))
        return cls(first_ns, period_ns, -lead_ns, -min(LAST_MOMENT_NS, lead_ns // 2), device_first_ns)

    def time_ns(self, slot: int) -> int:
        """When a slot is."""
        return self.first_ns + round(slot * self.period_ns)

    def device_time_ns(self, slot: int) -> int | None:
        """What the camera's clock shows then; None: its trigger is not scheduled."""
        return None if self.device_first_ns is None else self.device_first_ns + round(slot * self.period_ns)

    def first_from(self, time_ns: int) -> int:
        """The first slot at a time or later."""
        return math.ceil((time_ns - self.first_ns) / self.period_ns)


class Pacer:
    """Goes from slot to slot. After a pause it continues with the present one: it does not make up for missed slots.

    `slots` may be moved, as clocks drift: each keeps its number.
    """

    def __init__(self, slots: Slots, now_ns: int) -> None:
        self.slots = slots
        self._next = slots.first_from(now_ns - slots.opens_ns)

    @property
    def due_ns(self) -> int:
        """When the next trigger is to be given."""
        return self.slots.time_ns(self._next) + self.slots.opens_ns

    def take(self, now_ns: int) -> tuple[int | None, int]:
        """The slot to give a trigger for now, and how many closed without one since the last call."""
        missed = max(self.slots.first_from(now_ns - self.slots.closes_ns) - self._next, 0)
        self._next += missed
        if self.due_ns > now_ns:
            return None, missed
        self._next += 1
        return self._next - 1, missed


_CLOCK_PERIOD_NS = 1_000_000_000  # a crystal off by 50 ppm drifts 50 us in this time, far below a trigger period
_SHORTEST_BACK_OFF_NS = 100_000_000
_LONGEST_BACK_OFF_NS = 2_000_000_000
_TEMPERATURE_PERIOD_NS = 10_000_000_000  # a camera takes minutes to warm up
_LOG_PAUSE_S = 600.0
_FRAME_POLL_S = 0.05
_BACKLOG = 24  # frames that may wait for the control thread before pixels are dropped
_NO_PIXELS = np.empty((0, 0), np.uint8)


class Supervisor:
    """Keeps one camera open, writes requested settings, and reports everything that happens.

    The camera starts with the setting `start`. One that sends nothing for `silence_s` is reported silent and checked
    for an answer. `news` is notified when something may be due earlier than before.
    """

    def __init__(
        self,
        camera: CameraName,
        opener: Callable[[], Camera],
        silence_s: float,
        start: ExposureSetting,
        events: EventQueue,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.news = threading.Condition()
        self._side = camera
        self._opener = opener
        self._silence_ns = round(silence_s * 1e9)
        self._poll_s = min(_FRAME_POLL_S, silence_s)
        self._events = events
        self._now_ns = now_ns
        self._throttle = LogThrottle(_LOG_PAUSE_S)
        self._wanted = start
        self._pending: tuple[ExposureSetting, int, int] | None = None  # with its time and number
        self._pacer: Pacer | None = None  # while it is open and triggered by the host
        self._camera: Camera | None = None  # while it is open and streams
        self._opened_ns = 0
        self._back_off_ns = _SHORTEST_BACK_OFF_NS
        self._open_due_ns: float = 0
        self._latch_due_ns = 0
        self._temperature_due_ns = 0
        self._check_wanted = False  # by the thread that takes frames
        self._stuck = ""  # why it is to be reopened
        self._taking = threading.Lock()
        self._take_due_ns = 0
        self._last_frame_ns = 0
        self._silent = False

    def request(self, setting: ExposureSetting, not_before_ns: int, command: int) -> None:
        """Write `setting`, no earlier than `not_before_ns`, as this command; replaces a pending write. Any thread."""
        with self.news:
            self._wanted = setting
            self._pending = setting, not_before_ns, command
            self.news.notify_all()

    def pace(self, slots: Slots) -> None:
        """Trigger the camera in these slots until it is closed; replaces, or moves, the former ones. Any thread."""
        with self.news:
            if self._pacer is not None:
                self._pacer.slots = slots
            elif self._camera is not None:
                self._pacer = Pacer(slots, self._now_ns())
            self.news.notify_all()

    def reopen(self, why: str) -> None:
        """Close and reopen the camera, because it sends nothing although it should. Any thread."""
        with self.news:
            self._stuck = why
            self.news.notify_all()

    @property
    def serve_due_ns(self) -> float:
        """When `serve` next has something to do; infinite for a camera that can never be driven."""
        if self._camera is None:
            return self._open_due_ns
        if self._check_wanted or self._stuck:
            return 0
        due_ns: float = self._latch_due_ns  # of the clock
        if self._pacer is not None:
            # It is read after a trigger, not while the next one falls due, unless that takes long.
            due_ns = min(self._pacer.due_ns, self._latch_due_ns + _CLOCK_PERIOD_NS)
        return due_ns if self._pending is None else min(due_ns, self._pending[1])

    def serve(self) -> None:
        """Do the next thing that is due at the nodes: open the camera, trigger it, write, or read its clock."""
        camera = self._camera
        if camera is None:
            self._open()
            return
        if self._stuck:
            self.close()
            stuck = f"camera {camera.description.serial} {self._stuck}; it is reopened"
            self._report_gone(CameraLostError(stuck), final=False)
            return
        now_ns, due = self._now_ns(), None
        triggers = self._pacer is not None and self._pacer.due_ns <= now_ns
        with self.news:
            if not triggers and self._pending is not None and self._pending[1] <= now_ns:
                due, self._pending = self._pending, None
            check, self._check_wanted = self._check_wanted, False
        try:
            if triggers:
                self._trigger(camera)
            if due is not None:
                self._write(camera, due[0], due[2])
            elif check or now_ns >= self._latch_due_ns:
                self._latch_clock(camera)
        except CameraError as error:
            self._lose(camera, error)

    @property
    def take_due_ns(self) -> float:
        """When `take_frame` next has something to do; infinite while no camera streams."""
        return math.inf if self._camera is None else self._take_due_ns

    def take_frame(self) -> None:
        """Wait a moment for a frame and report it, or that frames have stopped."""
        with self._taking:
            camera = self._camera
            if camera is None:
                return
            try:
                frame = camera.next_frame(self._poll_s)
            except CameraLostError:
                self._take_due_ns = self._now_ns() + self._silence_ns
                self._want_check()
                return
            if frame is not None:
                stale = self._events.qsize() > _BACKLOG
                if stale and isinstance(frame, Frame):
                    frame = replace(frame, pixels=_NO_PIXELS)
                self._events.put(FrameArrived(self._side, frame, stale))
                self._last_frame_ns, self._silent = self._now_ns(), False
            elif not self._silent and self._now_ns() - self._last_frame_ns > self._silence_ns:
                self._silent = True
                self._events.put(CameraSilent(self._side))
                self._want_check()

    def close(self) -> None:
        """Close the camera, if open: the last call, on the thread of `serve`."""
        camera = self._camera
        if camera is not None:
            self._end_frames()
            camera.close()

    def _open(self) -> None:
        try:
            camera = self._opener()
        except AutoexposeError as error:
            self._report_gone(error, stays(error))
            return
        self._opened_ns = self._now_ns()
        with self.news:
            wanted, self._pending = self._wanted, None
        try:
            self._write(camera, camera.limits.nearest(wanted), OPENING)
            camera.start()
        except CameraError as error:
            self._lose(camera, error, stays(error))
            return
        with self.news:  # `pace`, which answers the event, must find the camera
            self._events.put(CameraReady(self._side, camera.description, camera.limits))
            self._last_frame_ns = self._take_due_ns = self._now_ns()
            self._latch_due_ns = self._last_frame_ns + _CLOCK_PERIOD_NS
            self._check_wanted = self._silent = False
            self._stuck = ""
            self._camera = camera
            self.news.notify_all()

    def _lose(self, camera: Camera, error: CameraError, final: bool = False) -> None:
        self._end_frames()
        if self._now_ns() - self._opened_ns > _LONGEST_BACK_OFF_NS:
            self._back_off_ns = _SHORTEST_BACK_OFF_NS
        self._report_gone(error, final)
        # A dead camera is closed on another thread: that takes up to 10 s, and it may be back long before.
        threading.Thread(target=camera.close, name=f"close-{self._side}", daemon=True).start()

    def _report_gone(self, error: AutoexposeError, final: bool) -> None:
        """Report it, and back off before the next attempt."""
        self._events.put(CameraGone(self._side, error, final))
        self._open_due_ns = math.inf if final else self._now_ns() + self._back_off_ns
        self._back_off_ns = min(2 * self._back_off_ns, _LONGEST_BACK_OFF_NS)

    def _end_frames(self) -> None:
        """From now on no frame is reported."""
        with self.news:  # not while `pace` sets one
            self._camera = self._pacer = None
        with self._taking:
            pass

    def _trigger(self, camera: Camera) -> None:
        pacer = self._pacer
        assert pacer is not None
        with self.news:
            slot, missed = pacer.take(self._now_ns())
            device_time_ns = None if slot is None else pacer.slots.device_time_ns(slot)
        if missed:  # before the trigger: its frame may come sooner than the acknowledgement
            self._events.put(NotTriggered(self._side, missed))
        try:
            if device_time_ns is not None:
                camera.schedule(device_time_ns)
            elif slot is not None:
                camera.trigger()
        except CameraLostError:
            raise
        except CameraError as error:
            self._events.put(NotTriggered(self._side, 1))
            if self._throttle.due("trigger", self._now_ns()):
                log.warning("%s camera: it was not triggered: %s", self._side, error)

    def _write(self, camera: Camera, setting: ExposureSetting, command: int) -> None:
        started_ns = self._now_ns()
        try:
            read_back = camera.write(setting)
        except CameraLostError:
            raise
        except CameraError as error:
            self._events.put(WriteFailed(self._side, setting, error))
            return
        self._events.put(Written(self._side, setting, read_back, started_ns, self._now_ns(), command))

    def _latch_clock(self, camera: Camera) -> None:
        """Also shows whether a silent camera still answers, or others send in its place."""
        try:
            refused = camera.refused_packets()
            if refused is not None:
                self._events.put(PacketsRefused(self._side, refused))
            reading = camera.latch_clock()
            if reading is not None:
                self._events.put(ClockRead(self._side, reading))
            self._read_temperature(camera)
        except CameraLostError:
            raise
        except CameraError as error:
            if self._throttle.due("clock", self._now_ns()):
                log.warning("%s camera: its clock could not be read: %s", self._side, error)
        self._latch_due_ns = self._now_ns() + _CLOCK_PERIOD_NS

    def _read_temperature(self, camera: Camera) -> None:
        now_ns = self._now_ns()
        if now_ns >= self._temperature_due_ns:
            self._temperature_due_ns = now_ns + _TEMPERATURE_PERIOD_NS
            temperature_c = camera.temperature_c()
            if temperature_c is not None:
                self._events.put(TemperatureRead(self._side, temperature_c))

    def _want_check(self) -> None:
        with self.news:
            self._check_wanted = True
            self.news.notify_all()
