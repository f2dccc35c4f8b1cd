"""The control thread: takes what the rig reports, pairs it, decides, and has both cameras written."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from autoexpose_daemon.command_effect import CommandToEffect
from autoexpose_daemon.config import Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.observer import Observer, Outlet
from autoexpose_daemon.response_drift import ResponseDrift
from autoexpose_daemon.telemetry import GONE, Telemetry
from autoexpose_daemon.tuning import Tuning
from calibration.response import ResponseFunction
from drivers.account import Tally, TriggerAccount
from drivers.camera import Camera, IncompleteFrame
from drivers.errors import AutoexposeError, ConfigurationError
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frame_memory import share_one_heap
from drivers.frames import Frame, Side, StereoPair
from drivers.rig import (
    CameraGone,
    CameraReady,
    CameraSilent,
    FrameArrived,
    Rig,
    RigEvent,
    WriteFailed,
    Written,
)
from drivers.seldom import Seldom
from drivers.start_check import StartCheck
from drivers.write_ledger import WriteLedger
from drivers.write_window import when_to_write_ns

log = logging.getLogger(__name__)

_STOP_S = 9.0  # a camera that does not answer holds up its teardown for 5 to 10 s
_BEAT_S = 0.1
_SILENCE_S = 0.2
_SILENCE_PERIODS = 3.0
_SILENCE_SAID_S = 60.0  # a trigger much slower than configured makes each frame end a silence


class Daemon:
    """Exposes the cameras of a rig well, until told to stop.

    Parameters
    ----------
    config
        The checked configuration.
    openers
        For each side, what opens its camera.
    observer
        Told of every pair, on the control thread.
    start
        The setting the cameras begin with; None: as configured.
    """

    def __init__(
        self,
        config: Config,
        openers: Mapping[Side, Callable[[], Camera]],
        observer: Observer | None = None,
        start: ExposureSetting | None = None,
    ) -> None:
        self.telemetry = Telemetry()
        self.outlets: list[Outlet] = []
        """Opened and closed by `run`, and told of every step."""
        self.beat_ns = 0
        """When the control thread last began a turn (CLOCK_MONOTONIC); it does ten times a second, come what may."""
        self._config = config
        self._tuning = Tuning(config)
        self._drift = ResponseDrift(config, self._tuning.responses)
        self._tunings: queue.SimpleQueue[tuple[Tuning, Future[None]]] = queue.SimpleQueue()
        self._newest: StereoPair | None = None
        self._observer = observer
        period_s = 1.0 / config.trigger.rate_hz
        self._asked = start or config.start
        self._rig = Rig(openers, max(_SILENCE_S, _SILENCE_PERIODS * period_s), self._asked)
        self._account = TriggerAccount(
            tuple(openers),
            period_s * 1e9,
            time.monotonic_ns(),
            "frame_id" if config.trigger.mode == "free_run" else "time",
        )
        lines = dict.fromkeys(config.triggered_sides, config.trigger.line)
        self._start_check = StartCheck(lines, config.trigger.rate_hz)
        self._limits: dict[Side, ExposureLimits] = {}
        self._pixel_formats: dict[Side, str | None] = {}
        self._shared_limits: ExposureLimits | None = None
        self._loop: ControlLoop | None = None
        self._asked_arrival_ns: int | None = None
        self._ledger = WriteLedger(tuple(openers))
        self._effects = CommandToEffect(tuple(openers))
        self._last_trigger = -1
        self._off_rate = False
        self._write_again = False
        self._complaints: set[tuple[Side, str]] = set()
        self._seldom = Seldom(_SILENCE_SAID_S)

    @property
    def tally(self) -> Tally:
        """The account of triggers so far."""
        return self._account.tally

    @property
    def tuning(self) -> Tuning:
        """What control goes by at present."""
        return self._tuning

    @property
    def loop(self) -> ControlLoop | None:
        """What decides at present: for observers, who are called on its thread."""
        return self._loop

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set, then leave the cameras stopped and free.

        Raises
        ------
        UnsupportedCameraError, ConfigurationError
            When a camera can never be driven as configured.
        """
        share_one_heap()
        self.telemetry.opened_ns = time.monotonic_ns()
        with ExitStack() as outlets:
            for outlet in self.outlets:
                outlets.enter_context(outlet)
            self._rig.start()
            try:
                self._warm_up()
                while not stop.is_set():
                    self.beat_ns = time.monotonic_ns()
                    self._take(self._next_events())
                    self._tune()
            except BaseException as error:
                self.telemetry.failed(error)
                raise
            finally:
                self._account.close(time.monotonic_ns())
                self._publish_tally()
                self._stop_rig()

    def _stop_rig(self) -> None:
        deadline_s = time.monotonic() + _STOP_S
        while not self._rig.stop(_BEAT_S):
            self.beat_ns = time.monotonic_ns()
            if time.monotonic() > deadline_s:
                log.error("a camera did not answer while stopping; it frees itself when its heartbeat runs out")
                return

    def tune(self, tuning: Tuning) -> Future[None]:
        """Have control go on by another tuning, with the cameras as they are.

        The future holds a ConfigurationError when it does not fit cameras or frames: nothing has changed then.
        """
        taken: Future[None] = Future()
        self._tunings.put((tuning, taken))
        return taken

    def _tune(self) -> None:
        while not self._tunings.empty():  # this thread alone takes them out
            tuning, taken = self._tunings.get_nowait()
            try:
                tuning.check_belongs(self._pixel_formats)
                limits = tuning.limits(self._limits.values())
                loop = tuning.loop(limits)
                if self._newest is not None:
                    loop.step(self._newest)
            except ConfigurationError as error:
                taken.set_exception(error)
                continue
            self._tuning, self._drift = tuning, ResponseDrift(tuning.config, tuning.responses)
            if self._limits:
                self._install(loop, limits)
            taken.set_result(None)

    def _warm_up(self) -> None:
        """Decide on a black frame while the cameras are being searched for: OpenCV's first calls take 50 ms."""
        black = Frame(np.zeros((540, 720), np.uint8), 8, 0, 0, 0, 0, self._config.start)
        loop = ControlLoop(
            self._config.control.policy, ResponseFunction.linear(), self._config.exposure.limits(), self._config.start
        )
        loop.step(StereoPair(0, black, black))
        loop.step(StereoPair(1, replace(black, device_time_ns=1), None))

    def _next_events(self) -> list[RigEvent]:
        """All that has happened, waiting a moment for the first."""
        try:
            events = [self._rig.events.get(timeout=_BEAT_S)]
        except queue.Empty:
            return []
        while not self._rig.events.empty():  # this thread alone takes events out
            events.append(self._rig.events.get_nowait())
        return events

    def _take(self, events: list[RigEvent]) -> None:
        pairs = [pair for event in events for pair in self._handle(event)]
        if pairs:
            newest = max(pairs, key=lambda pair: (pair.trigger, len(pair.frames)))
            for pair in pairs:
                if pair.trigger != newest.trigger and len(pair.frames) == len(self._config.sides):
                    self.telemetry.undecided_pairs += 1
                    self._deliver(pair, None)
            if newest.trigger > self._last_trigger:  # a pair may come after one of its frames was used alone
                self._last_trigger = newest.trigger
                self._step(newest)
        if events:
            self._publish_tally()
        for finding in self._start_check.findings(time.monotonic_ns()):
            log.warning("%s", finding)

    def _handle(self, event: RigEvent) -> list[StereoPair]:
        """Account for one event; returns the pairs it completed."""
        match event:
            case FrameArrived(side, IncompleteFrame() as frame):
                return self._account.incomplete(side, frame)
            case FrameArrived(side, Frame() as frame, stale=True):
                return self._account.stale(side, frame)
            case FrameArrived(side, Frame() as frame):
                self.telemetry.last_frame_ns[side] = frame.arrival_time_ns
                self._start_check.frame(side, frame.host_time_ns)
                return self._account.frame(side, frame)
            case CameraSilent(side):
                if self._seldom.due(side, time.monotonic_ns()):
                    log.warning("%s camera: no frames; asking whether it is there", side)
                return self._account.silent(side)
            case CameraGone(side, error, final):
                self._on_gone(side, error, final)
                return self._account.gone(side)
            case CameraReady():
                self._on_ready(event)
            case Written():
                self._on_written(event)
            case WriteFailed(side, asked, error):
                self.telemetry.refused_writes += 1
                self._write_again = True
                self._complain(side, "refused", f"{asked} was refused: {error}")
        return []

    def _on_ready(self, event: CameraReady) -> None:
        side, camera = event.side, event.description
        if side in self._limits:
            self.telemetry.reconnects += 1
        self._complaints.discard((side, "gone"))
        log.info("%s camera: %s %s %s, ready", side, camera.vendor, camera.model, camera.serial)
        for lack in camera.lacks:
            log.warning("%s camera %s: %s", side, camera.serial, lack)
        self.telemetry.cameras[side] = f"{camera.model} {camera.serial}"
        self._limits[side] = event.limits
        self._pixel_formats[side] = camera.pixel_format
        self._start_check.ready(side, time.monotonic_ns())
        limits = self._tuning.limits(self._limits.values())
        if limits != self._shared_limits:
            self._install(self._tuning.loop(limits), limits)

    def _install(self, loop: ControlLoop, limits: ExposureLimits) -> None:
        log.info(
            "exposure within %g to %g us, %g to %g dB",
            limits.min_time_us, limits.max_time_us, limits.min_gain_db, limits.max_gain_db,
        )  # fmt: skip
        if loop.shortfall:
            log.warning("policy %s: %s", self._tuning.config.control.policy, loop.shortfall)
        self._loop, self._shared_limits = loop, limits

    def _on_gone(self, side: Side, error: AutoexposeError, final: bool) -> None:
        self.telemetry.cameras[side] = GONE
        self._ledger.gone(side)
        self._effects.gone(side)
        if final:
            raise error
        self._complain(side, "gone", f"{error}; trying again")

    def _on_written(self, event: Written) -> None:
        self._ledger.written(event, self._account.grid)
        self.telemetry.late_writes = self._ledger.late
        self.telemetry.write_ms.add_ns(event.finished_ns - event.started_ns)
        if event.asked is self._asked and self._asked_arrival_ns is not None:
            self.telemetry.frame_to_node_ms.add_ns(event.finished_ns - self._asked_arrival_ns)
        self._complaints.discard((event.side, "refused"))
        if event.read_back.agrees_with(event.asked):
            self._complaints.discard((event.side, "clipped"))
        else:
            self.telemetry.clipped_writes += 1
            self._complain(event.side, "clipped", f"{event.asked} was asked for, the camera took {event.read_back}")

    def _complain(self, side: Side, kind: str, complaint: str) -> None:
        """Say a thing when it begins, not at every repetition."""
        if (side, kind) not in self._complaints:
            self._complaints.add((side, kind))
            log.warning("%s camera: %s", side, complaint)

    def _step(self, pair: StereoPair) -> None:
        if self._loop is None:
            return
        started_ns = time.monotonic_ns()
        decision = self._loop.step(pair)
        self._newest = pair
        decided_ns = time.monotonic_ns()
        self.telemetry.decision_ms.add_ns(decided_ns - started_ns)
        self.telemetry.decided(decision, self._loop.setup.limits)
        if decision.setting != self._asked or self._write_again:
            self._effects.commanded(decision.setting, decided_ns)
            self._asked, self._write_again = decision.setting, False
            self._asked_arrival_ns = max(frame.arrival_time_ns for frame in pair.frames)
            self._rig.write(decision.setting, self._when_to_write_ns())
        self._deliver(pair, decision)

    def _deliver(self, pair: StereoPair, decision: Decision | None) -> None:
        """Note what a pair shows, and hand it on."""
        self.telemetry.delivered(pair, complete=len(pair.frames) == len(self._config.sides))
        for side, frame in pair.by_side.items():
            if (effect_ns := self._effects.shown(side, frame)) is not None:
                self.telemetry.command_to_effect_ms.add_ns(effect_ns)
        if self._ledger.mismatched(pair):
            self.telemetry.mismatched_pairs += 1
            self.telemetry.unexplained_mismatches += not self._ledger.explains(pair)
        self._drift.see(pair)
        self.telemetry.drift_grey, self.telemetry.misfits = self._drift.residual_grey, self._drift.misfits
        if self._observer is not None:
            self._observer(pair, decision)
        for outlet in self.outlets:
            outlet(pair, decision)

    def _when_to_write_ns(self) -> int:
        now_ns, grid = time.monotonic_ns(), self._account.grid
        return now_ns if grid is None else when_to_write_ns(grid, now_ns)

    def _publish_tally(self) -> None:
        tally, grid = self._account.tally, self._account.grid
        if grid is not None and grid.off_rate and not self._off_rate:
            log.warning(
                "frames do not come at trigger.rate_hz %g: check the wiring, or mend it", self._config.trigger.rate_hz
            )
        self._off_rate = grid is not None and grid.off_rate
        self.telemetry.pairs = tally.pairs
        self.telemetry.lost = dict(tally.lost)
        self.telemetry.surplus_frames = tally.surplus_frames
