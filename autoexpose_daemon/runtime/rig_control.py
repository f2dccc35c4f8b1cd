"""Control of a rig: pairs what the rig reports, decides, has both cameras written, and keeps the telemetry.

There are no threads and no waiting here: whoever has the rig's events calls `RigControl.take`, on one thread.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.runtime.command_effect import CommandToEffect
from autoexpose_daemon.runtime.complaints import Complaints
from autoexpose_daemon.runtime.frame_watch import FrameWatch
from autoexpose_daemon.runtime.observer import Observer, Outlet
from autoexpose_daemon.runtime.response_drift import ResponseDrift
from autoexpose_daemon.runtime.stuck import StuckStreams
from autoexpose_daemon.runtime.tuning import Tuning
from autoexpose_daemon.runtime.way_to_nodes import Command, WayToNodes
from autoexpose_daemon.status.telemetry import GONE, Telemetry
from drivers.camera import IncompleteFrame
from drivers.errors import AutoexposeError
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import Frame, Side, StereoPair
from drivers.log_throttle import LogThrottle
from drivers.rig.events import (
    CameraGone,
    CameraReady,
    CameraSilent,
    FrameArrived,
    RigEvent,
    WriteFailed,
    Written,
)
from drivers.triggers.account import Tally, TriggerAccount
from drivers.triggers.start import StartCheck
from drivers.triggers.window import WriteWindow
from drivers.triggers.writes import WriteLedger

log = logging.getLogger(__name__)

_SILENCE_SAID_S = 60.0  # a trigger much slower than configured makes each frame end a silence


class Cameras(Protocol):
    """What control asks of a rig."""

    def write(self, setting: ExposureSetting, not_before_ns: int) -> None:
        """Have every camera take `setting`, not before a time; a write still waiting is replaced."""

    def reopen(self, side: Side) -> None:
        """Close and open a camera that answers, but sends nothing."""


class RigControl:
    """Exposes the cameras of a rig well, by what they report.

    Parameters
    ----------
    config
        The checked configuration.
    cameras
        Those of the rig.
    observer
        Told of every pair.
    start
        The setting the cameras begin with; None: as configured.
    now_ns
        The clock: CLOCK_MONOTONIC, but in virtual time.
    """

    def __init__(
        self,
        config: Config,
        cameras: Cameras,
        observer: Observer | None = None,
        start: ExposureSetting | None = None,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._complaints = Complaints()
        self.telemetry = Telemetry(complaints=self._complaints.present)
        self.outlets: list[Outlet] = []
        """Told of every pair, as the observer is."""
        self.angular_rate: Callable[[], float | None] = lambda: None
        """Asked before each decision how fast the camera turns, rad/s; None: not known."""
        self._config = config
        self._cameras = cameras
        self._now_ns = now_ns
        self._tuning = Tuning(config)
        self._drift = ResponseDrift(config)
        self._newest: StereoPair | None = None
        self._observer = observer
        self._asked = start or config.start
        self._account = TriggerAccount(
            tuple(config.sides),
            1e9 / config.trigger.rate_hz,
            now_ns(),
            "frame_id" if config.trigger.mode == "free_run" else "time",
        )
        lines = dict.fromkeys(config.triggered_sides, config.trigger.line)
        self._start_check = StartCheck(lines, config.trigger.rate_hz)
        self._frame_watch = FrameWatch(self.telemetry, self._complaints, config.trigger.rate_hz, lines)
        self._stuck = StuckStreams(1.0 / config.trigger.rate_hz)
        self._limits: dict[Side, ExposureLimits] = {}
        self._pixel_formats: dict[Side, str | None] = {}
        self._shared_limits: ExposureLimits | None = None
        self._loop: ControlLoop | None = None
        self._ledger = WriteLedger()
        self._effects = CommandToEffect(tuple(config.sides))
        self._way = WayToNodes(self.telemetry)
        self._window = WriteWindow()
        self._last_trigger = -1
        self._write_again = False
        self._throttle = LogThrottle(_SILENCE_SAID_S)

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

    def tune(self, tuning: Tuning) -> None:
        """Go on by another tuning.

        Raises
        ------
        ConfigurationError
            When it does not fit cameras or frames: nothing has changed then.
        """
        tuning.check_belongs(self._pixel_formats)
        limits = tuning.limits(self._limits.values())
        loop = tuning.loop(limits)
        if self._newest is not None:
            loop.step(self._newest)
        self._tuning, self._drift = tuning, ResponseDrift(tuning.config)
        if self._limits:
            self._install(loop, limits)

    def close(self) -> None:
        """Account for the triggers up to now that will never make a pair."""
        self._account.close(self._now_ns())
        self._publish_tally()

    def take(self, events: Sequence[RigEvent]) -> None:
        """Act on all that has happened since the last call; also called when nothing has, ten times a second.

        Raises
        ------
        UnsupportedCameraError, ConfigurationError
            When a camera can never be driven as configured.
        """
        pairs = [pair for event in events for pair in self._handle(event)]
        if pairs:
            newest = max(pairs, key=lambda pair: (pair.trigger, len(pair.frames)))
            for pair in pairs:
                if pair.trigger != newest.trigger and len(pair.frames) == len(self._config.sides):
                    self.telemetry.counts.pairs_without_decision += 1
                    self._deliver(pair, None)
            if newest.trigger > self._last_trigger:  # a pair may come after one of its frames was used alone
                self._last_trigger = newest.trigger
                self._step(newest)
        if events:
            self._publish_tally()
        now_ns = self._now_ns()
        for finding in self._start_check.findings(now_ns):
            log.warning("%s", finding)
        for side in self._stuck.sides(self.telemetry, now_ns):
            self._cameras.reopen(side)

    def _handle(self, event: RigEvent) -> list[StereoPair]:
        """Account for one event; returns the pairs it completed."""
        match event:
            case FrameArrived(side, IncompleteFrame() as frame):
                self._frame_watch.incomplete(side)
                return self._account.incomplete(side, frame)
            case FrameArrived(side, Frame() as frame, stale=True):
                return self._account.stale(side, frame)
            case FrameArrived(side, Frame() as frame):
                self.telemetry.last_frame_ns[side] = frame.arrival_time_ns
                self._start_check.frame(side, frame.host_time_ns)
                self._frame_watch.frame(side, frame)
                return self._account.frame(side, frame)
            case CameraSilent(side):
                if self._throttle.due(side, self._now_ns()):
                    log.warning("%s camera: no frames; asking whether it is there", side)
                self._frame_watch.silent(side)
                return self._account.silent(side)
            case CameraGone(side, error, final):
                self._on_gone(side, error, final)
                return self._account.gone(side)
            case CameraReady():
                self._on_ready(event)
            case Written():
                self._on_written(event)
            case WriteFailed(side, asked, error):
                self.telemetry.counts.refused_writes += 1
                self._write_again = True
                self._frame_watch.refused(side)
                self._complaints.begin(side, "refused", f"{asked} was refused: {error}")
        return []

    def _on_ready(self, event: CameraReady) -> None:
        side, camera = event.side, event.description
        if side in self._limits:
            self.telemetry.counts.reconnects += 1
        self._complaints.end(side, GONE)
        log.info("%s camera: %s %s %s, ready", side, camera.vendor, camera.model, camera.serial)
        for limitation in camera.limitations:
            log.warning("%s camera %s: %s", side, camera.serial, limitation)
        self.telemetry.cameras[side] = f"{camera.model} {camera.serial}"
        self._limits[side] = event.limits
        self._pixel_formats[side] = camera.pixel_format
        self._start_check.ready(side, self._now_ns())
        self._account.ready(side, self._now_ns())
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
        if self.telemetry.cameras.get(side) != GONE:
            self._complaints.end_all(side)
        self.telemetry.cameras[side] = GONE
        self._ledger.gone(side)
        self._frame_watch.gone(side)
        self._effects.gone(side)
        self._way.gone(side)
        if final:
            raise error
        self._complaints.change(side, GONE, f"{error}; trying again")

    def _on_written(self, event: Written) -> None:
        self._ledger.written(event, self._account.grid)
        self.telemetry.counts.late_writes = self._ledger.late
        if (command := self._way.written(event)) is not None and not command.held:
            self._window.took(event.finished_ns - command.decided_ns)
        self._frame_watch.written(event.side, event.read_back, event.finished_ns)
        self._complaints.end(event.side, "refused")
        if event.read_back.agrees_with(event.asked):
            self._complaints.end(event.side, "clipped")
        else:
            self.telemetry.counts.adjusted_writes += 1
            taken = f"{event.asked} was asked for, the camera took {event.read_back}"
            self._complaints.begin(event.side, "clipped", taken)

    def _step(self, pair: StereoPair) -> None:
        if self._loop is None:
            return
        arrival_ns, started_ns = max(frame.arrival_time_ns for frame in pair.frames.values()), self._now_ns()
        decision = self._loop.step(pair, self.angular_rate())
        self._newest = pair
        decided_ns = self._now_ns()
        self.telemetry.pairing_ms.add_ns(started_ns - arrival_ns)
        self.telemetry.decision_ms.add_ns(decided_ns - started_ns)
        self.telemetry.decided(decision, self._loop.setup.limits)
        if decision.setting != self._asked or self._write_again:
            self._effects.commanded(decision.setting, decided_ns)
            self._asked, self._write_again = decision.setting, False
            grid = self._account.grid
            due_ns = decided_ns if grid is None else self._window.next_ns(grid, decided_ns)
            command = Command(decision.setting, arrival_ns, decided_ns, held=due_ns > decided_ns)
            self._way.decided(command, self.telemetry.present)
            self._cameras.write(decision.setting, due_ns)
        self._deliver(pair, decision)

    def _deliver(self, pair: StereoPair, decision: Decision | None) -> None:
        """Note what a pair shows, and hand it on."""
        self.telemetry.delivered(pair, complete=len(pair.frames) == len(self._config.sides))
        for side, frame in pair.frames.items():
            if (effect_ns := self._effects.shown(side, frame)) is not None:
                self.telemetry.command_to_effect_ms.add_ns(effect_ns)
        if self._ledger.mismatched(pair):
            self.telemetry.counts.mismatched_pairs += 1
            self.telemetry.counts.unexplained_mismatches += not self._ledger.explains(pair)
        self._drift.see(pair)
        self.telemetry.drift_grey, self.telemetry.misfits = self._drift.residual_grey, self._drift.misfits
        if self._observer is not None:
            self._observer(pair, decision)
        for outlet in self.outlets:
            outlet(pair, decision)

    def _publish_tally(self) -> None:
        tally = self._account.tally
        self.telemetry.counts.pairs = tally.pairs
        self.telemetry.lost = dict(tally.lost)
        self.telemetry.counts.surplus_frames = tally.surplus_frames
