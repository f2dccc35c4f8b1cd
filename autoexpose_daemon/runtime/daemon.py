"""The daemon's control thread: passes the rig's events to control, and shows that it is alive."""

from __future__ import annotations

import logging
import queue
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.request import Request
from autoexpose_daemon.control.decision import Grounds
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.runtime.group_control import GroupControl, starts
from autoexpose_daemon.runtime.inputs import InputSource
from autoexpose_daemon.runtime.rig_control import Outlet, RigControl
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.status.counters import Answer
from drivers.camera import Camera
from drivers.host import come_first, share_one_heap
from drivers.rig import Rig
from drivers.rig.events import RigEvent
from drivers.triggers.outcomes import Tally
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import CameraGeometry
from imaging.response import ResponseFunction

log = logging.getLogger(__name__)

_STOP_S = 9.0  # a camera that does not answer holds up its teardown for 5 to 10 s
_BEAT_S = 0.1
_TURN_S = 0.0005
"""How long one thread may keep the others from running Python. With Python's default of 5 ms, drawing the terminal view
delayed a decision, or its write, by as long as the decision itself takes."""
_SILENCE_S = 0.2
_SILENCE_PERIODS = 3.0


def silence_s(config: Config) -> float:
    """How long a camera may send nothing before it is checked for an answer."""
    return max(_SILENCE_S, _SILENCE_PERIODS / config.trigger.rate_hz)


class Daemon:
    """Keeps the cameras of a rig well exposed until it is stopped."""

    def __init__(
        self,
        config: Config,
        openers: Mapping[CameraName, Callable[[], Camera]],  # for each side, a function that opens its camera
        start: ExposureSetting | None = None,  # the setting that the cameras start with; None: as configured
        outlets: Sequence[Outlet] = (),
    ) -> None:
        self._config = config
        self._rig = Rig(openers, silence_s(config), starts(config, start))
        self._control = RigControl(config, self._rig, start)
        self._orders: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.telemetry = self._control.telemetry
        self.outlets = self._control.outlets
        self.outlets += outlets
        """Opened and closed by `run`, and called at every step."""
        self._feeds: list[AbstractContextManager[Any]] = []
        self.beat_ns = 0
        """When the control thread last began a turn (CLOCK_MONOTONIC), which it does at least ten times a second."""

    @property
    def tally(self) -> Tally:
        """The account of triggers so far."""
        return self._control.record.tally

    @property
    def groups(self) -> Mapping[str, GroupControl]:
        """The groups of cameras: for observers, which are called on the control thread."""
        return self._control.groups

    @property
    def config(self) -> Config:
        """The configuration in use."""
        return self._control.config

    @property
    def tuning(self) -> Tuning:
        """The present tuning of the first group, which has all cameras if there is no other."""
        return self._control.first.active.tuning

    @property
    def loop(self) -> ControlLoop | None:
        """Its present loop."""
        return self._control.first.active.loop

    def follow(self, name: str, source: InputSource, feed: AbstractContextManager[Any] | None = None) -> None:
        """Have control ask a source for this field of `StepInputs` before each decision; `run` opens what feeds it."""
        self._control.sources[name] = source
        if feed is not None:
            self._feeds.append(feed)

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set, then stop and release the cameras.

        Raises ConfigurationError, UnsupportedCameraError or NodeError when a camera cannot be driven as configured, at
        the start or if no other one is left.
        """
        share_one_heap()
        sys.setswitchinterval(_TURN_S)
        self.telemetry.opened_ns = time.monotonic_ns()
        self._control.begin()
        with ExitStack() as outlets:
            for outlet in self.outlets:
                if isinstance(outlet, AbstractContextManager):
                    outlets.enter_context(outlet)
            for feed in self._feeds:
                outlets.enter_context(feed)
            come_first()  # and so do the threads of the rig, of streams, too, but not those of outlets
            self._rig.start()
            try:
                self._warm_up()
                while not stop.is_set():
                    self.beat_ns = time.monotonic_ns()
                    self._control.take(self._next_events())
                    self._obey()
            except BaseException as error:
                self.telemetry.failed(error)
                raise
            finally:
                self._control.close()
                self._stop_rig()

    def tune(self, tuning: Tuning) -> Future[None]:
        """Have control switch to another tuning; the cameras keep running.

        If it does not fit cameras or frames, the future holds a ConfigurationError. Nothing changes then, nor if it was
        cancelled in time.
        """
        taken: Future[None] = Future()
        self._orders.put(partial(self._tune, tuning, taken))
        return taken

    def ask(self, request: Request) -> Future[Answer]:
        """Have control change what a request asks for, between two pairs.

        The future holds an AutoexposeError if it is refused. Nothing changes then, nor if it was cancelled in time.
        """
        answer: Future[Answer] = Future()
        self._orders.put(partial(self._control.ask, request, answer))
        return answer

    def calibrate(self, geometries: Mapping[CameraName, CameraGeometry | None]) -> Future[None]:
        """Have the next frames go out with the geometry of these cameras, which is not checked; None: uncalibrated."""
        taken: Future[None] = Future()

        def calibrate() -> None:
            if taken.set_running_or_notify_cancel():
                for group in self.groups.values():
                    group.requests.calibrate(geometries)
                taken.set_result(None)

        self._orders.put(calibrate)
        return taken

    def explain(self, group: str) -> Future[Grounds | None]:
        """Have control tell, between two pairs, what a group's latest decision rests on; None if that is no belief."""
        told: Future[Grounds | None] = Future()
        active = self.groups[group].active
        self._orders.put(lambda: told.set_result(None if active.loop is None else active.loop.grounds))
        return told

    def _obey(self) -> None:
        while not self._orders.empty():  # only this thread takes them out
            self._orders.get_nowait()()

    def _tune(self, tuning: Tuning, taken: Future[None]) -> None:
        if not taken.set_running_or_notify_cancel():
            return
        try:
            self._control.tune(tuning)
        except ConfigurationError as error:
            taken.set_exception(error)
        else:
            taken.set_result(None)

    def _stop_rig(self) -> None:
        deadline_s = time.monotonic() + _STOP_S
        while not self._rig.stop(_BEAT_S):
            self.beat_ns = time.monotonic_ns()
            if time.monotonic() > deadline_s:
                log.error("a camera did not answer while stopping; it frees itself when its heartbeat runs out")
                return

    def _warm_up(self) -> None:
        """Decide on a black frame while the cameras are being searched for: OpenCV's first calls take 50 ms."""
        black = Frame(np.zeros((540, 720), np.uint8), 8, 0, 0, 0, 0, self._config.start)
        loop = ControlLoop(
            self._config.control.policy, ResponseFunction.linear(), self._config.exposure.limits(), self._config.start
        )
        loop.step(FrameSet(0, {"left": black, "right": black}))
        loop.step(FrameSet(1, {"left": replace(black, device_time_ns=1)}))

    def _next_events(self) -> list[RigEvent]:
        """All waiting events; waits a moment for the first."""
        try:
            events = [self._rig.events.get(timeout=_BEAT_S)]
        except queue.Empty:
            return []
        while not self._rig.events.empty():  # only this thread takes events out
            events.append(self._rig.events.get_nowait())
        return events


class ControlThread:
    """Runs a daemon until it is asked to stop; `error` is what ended it earlier."""

    def __init__(self, daemon: Daemon) -> None:
        self.error: BaseException | None = None
        self._daemon = daemon
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control")
        self._thread.start()

    def ask_to_stop(self) -> None:
        """Begin to stop: the cameras are freed first."""
        self._stop.set()

    def ended(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s` for it to end; returns whether it has."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._daemon.run(self._stop)
        except BaseException as error:
            self.error = error
