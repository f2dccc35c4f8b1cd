"""The cameras of a rig, each kept alive by threads of its own, so that a camera in trouble disturbs no other.

Per camera one thread owns the nodes (opens, writes, reads the clock, tears down, opens again) and one takes frames.
All that happens is put into a single queue of events, for the one thread that pairs frames and decides.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import Camera, CameraDescription, IncompleteFrame
from drivers.errors import (
    AutoexposeError,
    CameraError,
    CameraLostError,
    ConfigurationError,
    UnsupportedCameraError,
)
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import Frame, Side
from drivers.seldom import Seldom

log = logging.getLogger(__name__)

_CLOCK_PERIOD_S = 1.0  # a crystal off by 50 ppm drifts 50 us in it, far below a trigger period
_SHORTEST_BACK_OFF_S = 0.1
_LONGEST_BACK_OFF_S = 2.0
_CLOCK_SAID_S = 600.0
_FRAME_POLL_S = 0.05
_BACKLOG = 24  # frames that may wait for the control thread before pixels are let go
_NO_PIXELS = np.empty((0, 0), np.uint8)


@dataclass(frozen=True, slots=True)
class CameraReady:
    """A camera is open and streaming."""

    side: Side
    description: CameraDescription
    limits: ExposureLimits


@dataclass(frozen=True, slots=True)
class CameraSilent:
    """No frame has come for longer than the trigger explains; the camera may still answer."""

    side: Side


@dataclass(frozen=True, slots=True)
class CameraGone:
    """A camera is lost or cannot be opened; it is tried again unless `final`: it never can be."""

    side: Side
    error: AutoexposeError
    final: bool


@dataclass(frozen=True, slots=True, eq=False)
class FrameArrived:
    """A frame, whole or with holes; without pixels and `stale` when control is so far behind that nobody will look."""

    side: Side
    frame: Frame | IncompleteFrame
    stale: bool = False


@dataclass(frozen=True, slots=True)
class Written:
    """A setting was written: what was asked for, what the nodes read back, and when (CLOCK_MONOTONIC)."""

    side: Side
    asked: ExposureSetting
    read_back: ExposureSetting
    started_ns: int
    finished_ns: int


@dataclass(frozen=True, slots=True)
class WriteFailed:
    """A camera refused a setting."""

    side: Side
    asked: ExposureSetting
    error: CameraError


RigEvent = CameraReady | CameraSilent | CameraGone | FrameArrived | Written | WriteFailed


class Rig:
    """Runs one or two cameras until `stop`.

    Parameters
    ----------
    openers
        For each side, what opens its camera.
    silence_s
        A camera that sends nothing for this long is called silent and asked whether it is still there.
    start
        The setting each camera begins with.
    """

    def __init__(self, openers: Mapping[Side, Callable[[], Camera]], silence_s: float, start: ExposureSetting) -> None:
        self.events: queue.SimpleQueue[RigEvent] = queue.SimpleQueue()
        self._units = {side: _Unit(side, opener, silence_s, start, self.events) for side, opener in openers.items()}

    def start(self) -> None:
        """Start opening the cameras."""
        for unit in self._units.values():
            unit.start()

    def write(self, setting: ExposureSetting, not_before_ns: int) -> None:
        """Have every camera take `setting`, not before a host time; a write still waiting is replaced."""
        for unit in self._units.values():
            unit.request(setting, not_before_ns)

    def stop(self, timeout_s: float) -> bool:
        """Stop acquisition and close the cameras; False when one did not answer in time."""
        for unit in self._units.values():
            unit.ask_to_stop()
        deadline = time.monotonic() + timeout_s
        stopped = [unit.join(max(deadline - time.monotonic(), 0.0)) for unit in self._units.values()]
        return all(stopped)


class _Unit:
    """One camera's threads."""

    def __init__(
        self,
        side: Side,
        opener: Callable[[], Camera],
        silence_s: float,
        start: ExposureSetting,
        events: queue.SimpleQueue[RigEvent],
    ) -> None:
        self._side = side
        self._opener = opener
        self._silence_s = silence_s
        self._events = events
        self._wake = threading.Condition()
        self._wanted = start
        self._pending: tuple[ExposureSetting, int] | None = None
        self._trouble = False  # the frame thread wants the camera looked at
        self._stopping = False
        self._seldom = Seldom(_CLOCK_SAID_S)
        self._thread = threading.Thread(target=self._live, name=f"nodes-{side}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def request(self, setting: ExposureSetting, not_before_ns: int) -> None:
        with self._wake:
            self._wanted = setting
            self._pending = (setting, not_before_ns)
            self._wake.notify()

    def ask_to_stop(self) -> None:
        with self._wake:
            self._stopping = True
            self._wake.notify()

    def join(self, timeout_s: float) -> bool:
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _live(self) -> None:
        back_off_s = _SHORTEST_BACK_OFF_S
        ever_ran = False
        while not self._stopping:
            try:
                camera = self._opener()
            except AutoexposeError as error:
                final = isinstance(error, UnsupportedCameraError | ConfigurationError) and not ever_ran
                self._events.put(CameraGone(self._side, error.with_traceback(None), final))
                if final:
                    return
            else:
                began_s = time.monotonic()
                self._run_and_close(camera)
                ever_ran = True
                if time.monotonic() - began_s > _LONGEST_BACK_OFF_S:
                    back_off_s = _SHORTEST_BACK_OFF_S
            self._rest(back_off_s)
            back_off_s = min(2 * back_off_s, _LONGEST_BACK_OFF_S)

    def _run_and_close(self, camera: Camera) -> None:
        try:
            self._run(camera)
        except CameraError as error:
            # An error's traceback would keep the camera from being freed.
            self._events.put(CameraGone(self._side, error.with_traceback(None), final=False))
            # A dead camera is closed aside: that takes up to 10 s, and it may be back long before.
            threading.Thread(target=camera.close, name=f"close-{self._side}", daemon=True).start()
        else:
            camera.close()

    def _run(self, camera: Camera) -> None:
        """Stream and serve writes until told to stop, or until the camera is lost (raises CameraError)."""
        self._trouble = False
        self._write(camera, self._wanted)
        ended = threading.Event()
        frames = threading.Thread(target=self._take_frames, args=(camera, ended), name=f"frames-{self._side}")
        camera.start()
        self._events.put(CameraReady(self._side, camera.description, camera.limits))
        frames.start()
        try:
            self._serve(camera)
        finally:
            ended.set()
            frames.join()

    def _serve(self, camera: Camera) -> None:
        next_latch_s = time.monotonic() + _CLOCK_PERIOD_S
        while True:
            with self._wake:
                now_ns = time.monotonic_ns()
                due_s = next_latch_s - now_ns * 1e-9
                if self._pending is not None:
                    due_s = min(due_s, (self._pending[1] - now_ns) * 1e-9)
                if due_s > 0 and not self._stopping and not self._trouble:
                    self._wake.wait(due_s)
                if self._stopping:
                    return
                setting = None
                if self._pending is not None and self._pending[1] <= time.monotonic_ns():
                    setting, self._pending = self._pending[0], None
                look, self._trouble = self._trouble, False
            if setting is not None:
                self._write(camera, setting)
            elif look or time.monotonic() >= next_latch_s:
                self._latch_clock(camera)
                next_latch_s = time.monotonic() + _CLOCK_PERIOD_S

    def _latch_clock(self, camera: Camera) -> None:
        """Also tells whether a silent camera still answers."""
        try:
            camera.latch_clock()
        except CameraLostError:
            raise
        except CameraError as error:
            if self._seldom.due("clock", time.monotonic_ns()):
                log.warning("%s camera: its clock was not read: %s", self._side, error)

    def _write(self, camera: Camera, setting: ExposureSetting) -> None:
        started_ns = time.monotonic_ns()
        try:
            read_back = camera.write(setting)
        except CameraLostError:
            raise
        except CameraError as error:
            self._events.put(WriteFailed(self._side, setting, error.with_traceback(None)))
            return
        self._events.put(Written(self._side, setting, read_back, started_ns, time.monotonic_ns()))

    def _take_frames(self, camera: Camera, ended: threading.Event) -> None:
        last_s = time.monotonic()
        silent = False
        while not ended.is_set():
            try:
                frame = camera.next_frame(min(_FRAME_POLL_S, self._silence_s))
            except CameraLostError:
                self._look()
                ended.wait(self._silence_s)
                continue
            if frame is not None:
                stale = self._events.qsize() > _BACKLOG
                if stale and isinstance(frame, Frame):
                    frame = replace(frame, pixels=_NO_PIXELS)
                self._events.put(FrameArrived(self._side, frame, stale))
                last_s, silent = time.monotonic(), False
            elif not silent and time.monotonic() - last_s > self._silence_s:
                silent = True
                self._events.put(CameraSilent(self._side))
                self._look()

    def _look(self) -> None:
        with self._wake:
            self._trouble = True
            self._wake.notify()

    def _rest(self, seconds: float) -> None:
        """Wait all that time, or until told to stop: writes that are asked for meanwhile must not cut it short."""
        with self._wake:
            self._wake.wait_for(lambda: self._stopping, seconds)
