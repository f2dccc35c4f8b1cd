"""The health of a rig's cameras: what their events reveal, counted in telemetry, logged, and kept as complaints."""

from __future__ import annotations

import logging
from collections.abc import Mapping

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.complaints import Complaints
from autoexpose_daemon.runtime.frame_watch import FrameWatch
from autoexpose_daemon.runtime.response_drift import ResponseDrift
from autoexpose_daemon.runtime.stuck import StuckStreams
from autoexpose_daemon.runtime.tuning import Tuning
from autoexpose_daemon.status.states import ADJUSTED, START_PATIENCE_NS
from autoexpose_daemon.status.telemetry import GONE, Telemetry
from drivers.camera import IncompleteFrame
from drivers.log_throttle import LogThrottle
from drivers.rig.events import (
    CameraGone,
    CameraReady,
    CameraSilent,
    ClockRead,
    FrameArrived,
    PacketsRefused,
    RigEvent,
    WriteFailed,
    Written,
)
from drivers.triggers.host import HostTriggers
from drivers.triggers.record import RigRecord
from imaging.errors import AutoexposeError
from imaging.frames import Frame, Side, StereoPair

log = logging.getLogger(__name__)

_SILENCE_LOG_PAUSE_S = 60.0  # a trigger much slower than configured makes each frame end a silence

_WHOSE_PACKETS = (
    "if this is the camera, give it one address; if not, keep that sender off its network (docs/hostile-packets.md)"
)


class RigHealth:
    """Examines every event after the record has taken it."""

    def __init__(self, config: Config, telemetry: Telemetry, record: RigRecord, triggers: HostTriggers) -> None:
        self._telemetry = telemetry
        self._complaints = Complaints(telemetry.complaints)
        self._frame_watch = FrameWatch(telemetry, self._complaints, record, config)
        # By PTP, too, cameras expose only on request, which pauses while their clocks are not synchronised.
        needs_pulses = config.trigger.mode in ("external", "ptp")
        self._stuck = StuckStreams(1.0 / config.trigger.rate_hz, needs_pulses=needs_pulses)
        self._drift = ResponseDrift(config)
        self._record = record
        self._triggers = triggers
        self._sides = frozenset(config.sides)
        self._ever_ready: set[Side] = set()
        self._out: set[Side] = set()
        self._silent: set[Side] = set()
        self._throttle = LogThrottle(_SILENCE_LOG_PAUSE_S)

    def see(self, event: RigEvent, now_ns: int) -> None:
        """Look at an event; raises the error of a camera that cannot be driven: at the start, or if none is left."""
        if isinstance(event, FrameArrived):
            self._arrived(event.side, event.frame, now_ns)
        match event:
            case FrameArrived(side, IncompleteFrame()):
                self._frame_watch.incomplete(side)
            case FrameArrived(side, Frame() as frame, stale=False):
                self._telemetry.last_frame_ns[side] = frame.arrival_time_ns
                self._frame_watch.frame(side, frame)
            case CameraSilent(side):
                if side not in self._record.unpaced and self._throttle.due(side, now_ns):
                    log.warning("%s camera: no frames; checking that it answers", side)
                self._frame_watch.silent(side)
                self._silent.add(side)
            case PacketsRefused(side, packets):
                self._telemetry.counts.refused_packets += packets.count
                if side in self._silent:
                    self._complaints.begin(side, "strangers", f"{packets}: {_WHOSE_PACKETS}")
            case CameraGone(side, error, final):
                self._gone(side, error, final, now_ns)
            case CameraReady():
                self._ready(event)
            case Written():
                self._written(event)
            case ClockRead(side, reading):
                self._telemetry.ptp[side] = reading.ptp
            case WriteFailed(side, asked, error):
                self._telemetry.counts.refused_writes += 1
                self._frame_watch.refused(side)
                self._complaints.begin(side, "refused", f"{asked} was refused: {error}")

    def _arrived(self, side: Side, frame: Frame | IncompleteFrame, now_ns: int) -> None:
        """Look at any frame, whole or not, late or not."""
        self._stuck.arrived(side, now_ns)
        self._silent.discard(side)
        self._complaints.end(side, "strangers")
        if isinstance(frame, Frame) and frame.doubt is not None:
            self._frame_watch.doubt(side, frame.doubt)

    def pair(self, pair: StereoPair) -> None:
        """Look at a pair: do the cameras still respond as calibrated?"""
        self._drift.see(pair)
        self._telemetry.drift_grey, self._telemetry.misfits = self._drift.residual_grey, self._drift.misfits

    def counted(self, pair: StereoPair, uncounted: Mapping[Side, str]) -> None:
        """Note which frames of a pair did not count for the decision on it, and why."""
        for side in pair.frames:
            self._complaints.judge(side, "uncounted", uncounted.get(side))

    def tune(self, tuning: Tuning) -> None:
        """Continue with the responses of another tuning."""
        self._drift = ResponseDrift(tuning.config)

    def look(self, now_ns: int) -> dict[Side, str]:
        """To be called at least ten times a second; returns the cameras to reopen, and why."""
        for finding in self._record.findings(now_ns):
            log.warning("%s", finding)
        for side in self._telemetry.present:
            self._complaints.judge(side, "clock", self._triggers.trouble(side, now_ns))
        return self._stuck.reasons(self._telemetry.cameras, now_ns, self._record.unpaced)

    def _ready(self, event: CameraReady) -> None:
        side, camera = event.side, event.description
        self._telemetry.counts.reconnects += side in self._ever_ready
        self._ever_ready.add(side)
        self._complaints.end(side, GONE)
        log.info("%s camera: %s %s %s, ready", side, camera.vendor, camera.model, camera.serial)
        for limitation in camera.limitations:
            log.warning("%s camera %s: %s", side, camera.serial, limitation)
        self._telemetry.cameras[side] = f"{camera.model} {camera.serial}"

    def _gone(self, side: Side, error: AutoexposeError, final: bool, now_ns: int) -> None:
        if self._telemetry.cameras.get(side) != GONE:
            self._complaints.end_all(side)
        self._telemetry.cameras[side] = GONE
        self._telemetry.ptp.pop(side, None)
        self._frame_watch.gone(side)
        if final:
            self._out.add(side)
            if self._out == self._sides or (side not in self._ever_ready and self._starting(now_ns)):
                raise error
        what_now = "it stays out until the daemon is restarted" if final else "trying again"
        self._complaints.change(side, GONE, f"{error}; {what_now}")

    def _starting(self, now_ns: int) -> bool:
        opened_ns = self._telemetry.opened_ns
        return opened_ns is None or now_ns - opened_ns < START_PATIENCE_NS

    def _written(self, event: Written) -> None:
        self._complaints.end(event.side, "refused")
        if event.read_back.agrees_with(event.asked):
            self._complaints.end(event.side, ADJUSTED)
        else:
            self._telemetry.counts.adjusted_writes += 1
            taken = f"{event.asked} was asked for, the camera took {event.read_back}"
            self._complaints.begin(event.side, ADJUSTED, taken)
