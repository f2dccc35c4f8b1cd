"""Keeping one camera alive: open it, trigger it, write to it, check that it answers, close it and open it again.

There are no threads here. The caller calls `Supervisor.serve` on one thread, which owns the camera's nodes, and
`Supervisor.take_frame` on another, each when it is due by the given clock.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.camera import Camera
from drivers.log_throttle import LogThrottle
from drivers.rig.events import (
    CameraGone,
    CameraReady,
    CameraSilent,
    ClockRead,
    EventQueue,
    FrameArrived,
    NotTriggered,
    PacketsRefused,
    WriteFailed,
    Written,
)
from drivers.rig.pace import Pacer, Slots
from imaging.errors import AutoexposeError, CameraError, CameraLostError, stays
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side

log = logging.getLogger(__name__)

_CLOCK_PERIOD_NS = 1_000_000_000  # a crystal off by 50 ppm drifts 50 us in this time, far below a trigger period
_SHORTEST_BACK_OFF_NS = 100_000_000
_LONGEST_BACK_OFF_NS = 2_000_000_000
_LOG_PAUSE_S = 600.0
_FRAME_POLL_S = 0.05
_BACKLOG = 24  # frames that may wait for the control thread before pixels are dropped
_NO_PIXELS = np.empty((0, 0), np.uint8)


class Supervisor:
    """Keeps one camera open, writes requested settings, and reports everything that happens.

    Parameters
    ----------
    side
        Which camera of the rig it is.
    opener
        Opens the camera.
    silence_s
        A camera that sends nothing for this long is reported silent and checked for an answer.
    start
        The setting that the camera starts with.
    events
        Where to report.
    now_ns
        The clock: CLOCK_MONOTONIC, except in virtual time.

    Attributes
    ----------
    news
        Notified when something may be due earlier than before.
    """

    def __init__(
        self,
        side: Side,
        opener: Callable[[], Camera],
        silence_s: float,
        start: ExposureSetting,
        events: EventQueue,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.news = threading.Condition()
        self._side = side
        self._opener = opener
        self._silence_ns = round(silence_s * 1e9)
        self._poll_s = min(_FRAME_POLL_S, silence_s)
        self._events = events
        self._now_ns = now_ns
        self._throttle = LogThrottle(_LOG_PAUSE_S)
        self._wanted = start
        self._pending: tuple[ExposureSetting, int] | None = None
        self._pacer: Pacer | None = None  # while it is open and triggered by the host
        self._camera: Camera | None = None  # while it is open and streams
        self._opened_ns = 0
        self._back_off_ns = _SHORTEST_BACK_OFF_NS
        self._open_due_ns: float = 0
        self._latch_due_ns = 0
        self._check_wanted = False  # by the thread that takes frames
        self._stuck = ""  # why it is to be reopened
        self._taking = threading.Lock()
        self._take_due_ns = 0
        self._last_frame_ns = 0
        self._silent = False

    def request(self, setting: ExposureSetting, not_before_ns: int) -> None:
        """Write `setting`, no earlier than `not_before_ns`; replaces a pending write. Any thread."""
        with self.news:
            self._wanted = setting
            self._pending = (setting, not_before_ns)
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
        now_ns, setting = self._now_ns(), None
        triggers = self._pacer is not None and self._pacer.due_ns <= now_ns
        with self.news:
            if not triggers and self._pending is not None and self._pending[1] <= now_ns:
                setting, self._pending = self._pending[0], None
            check, self._check_wanted = self._check_wanted, False
        try:
            if triggers:
                self._trigger(camera)
            if setting is not None:
                self._write(camera, setting)
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
            self._write(camera, camera.limits.nearest(wanted))
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
        # An error's traceback would keep the camera from being freed.
        self._events.put(CameraGone(self._side, error.with_traceback(None), final))
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

    def _write(self, camera: Camera, setting: ExposureSetting) -> None:
        started_ns = self._now_ns()
        try:
            read_back = camera.write(setting)
        except CameraLostError:
            raise
        except CameraError as error:
            self._events.put(WriteFailed(self._side, setting, error.with_traceback(None)))
            return
        self._events.put(Written(self._side, setting, read_back, started_ns, self._now_ns()))

    def _latch_clock(self, camera: Camera) -> None:
        """Also shows whether a silent camera still answers, or others send in its place."""
        try:
            refused = camera.refused_packets()
            if refused is not None:
                self._events.put(PacketsRefused(self._side, refused))
            reading = camera.latch_clock()
            if reading is not None:
                self._events.put(ClockRead(self._side, reading))
        except CameraLostError:
            raise
        except CameraError as error:
            if self._throttle.due("clock", self._now_ns()):
                log.warning("%s camera: its clock could not be read: %s", self._side, error)
        self._latch_due_ns = self._now_ns() + _CLOCK_PERIOD_NS

    def _want_check(self) -> None:
        with self.news:
            self._check_wanted = True
            self.news.notify_all()
