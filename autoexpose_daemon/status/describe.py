"""The status of a daemon, from its telemetry, configuration and latest faults."""

from __future__ import annotations

import copy
import logging
import time
from collections import deque
from dataclasses import replace

from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.status.counters import DURATIONS
from autoexpose_daemon.status.document import (
    VERSION,
    CameraStatus,
    DurationStatus,
    Fault,
    GroupStatus,
    PublishStatus,
    RecorderStatus,
    Status,
)
from autoexpose_daemon.status.states import Expectation, Health, judge
from autoexpose_daemon.status.telemetry import GONE, DurationSamples, GroupTally, PublishTally, Telemetry
from documents.text import readable
from imaging.frames import CameraName

KEPT_FAULTS = 50
LONGEST_TEXT = 500
"""Characters of a fault; the rest is cut off."""


class FaultLog(logging.Handler):
    """Keeps the last log records at WARNING and above, one line each."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._faults: deque[Fault] = deque(maxlen=KEPT_FAULTS)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Oldest first."""
        return tuple(self._faults.copy())  # an atomic copy: other threads append

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record."""
        try:
            text = readable(" ".join(record.getMessage().split()))
        except Exception:  # a message that does not fit its arguments must not stop the log
            self.handleError(record)
            return
        self._faults.append(Fault(round(record.created, 3), record.levelname, text[:LONGEST_TEXT]))


def fault_log() -> FaultLog:
    """The fault log of this process; it starts listening at the first call."""
    root = logging.getLogger()
    for handler in root.handlers:
        if isinstance(handler, FaultLog):
            return handler
    handler = FaultLog()
    root.addHandler(handler)
    return handler


_STARTED_NS = time.monotonic_ns()  # start of the process, a second late: imports come first


def health_of(telemetry: Telemetry, config: Config) -> Health:
    """The present health of a daemon."""
    now_ns = time.monotonic_ns()
    triggered = config.trigger.mode == "external"
    opened_ns = now_ns if telemetry.opened_ns is None else telemetry.opened_ns
    expected = Expectation(tuple(config.cameras), 1.0 / config.trigger.rate_hz, triggered, opened_ns)
    return judge(telemetry, expected, now_ns)


def describe(telemetry: Telemetry, config: Config, ending: bool = False) -> Status:
    """The present status of a daemon; callable on any thread."""
    now_ns = time.monotonic_ns()
    health, recorder = health_of(telemetry, config), telemetry.recorder
    return Status(
        version=VERSION,
        rig=(config.publish or PublishConfig()).rig,
        policy=telemetry.first_group.policy or config.control.policy,
        unix_time_s=round(time.time(), 3),
        uptime_s=_seconds(now_ns - _STARTED_NS),
        open_s=_seconds(0 if telemetry.opened_ns is None else now_ns - telemetry.opened_ns),
        ending=ending,
        state=health.state,
        reasons=health.reasons,
        cameras={camera: _camera(telemetry, camera) for camera in config.cameras},
        rate_hz=round(telemetry.rate_hz(now_ns), 3),
        counts=replace(telemetry.counts),
        lost={str(reason): count for reason, count in list(telemetry.lost.items()) if count},
        decision=telemetry.decision,
        **{duration.field: _durations(getattr(telemetry, duration.field)) for duration in DURATIONS},
        publishing=None if telemetry.publishing is None else _publishing(telemetry.publishing, now_ns),
        recorder=None if recorder is None else RecorderStatus(recorder.steps, recorder.dropped, recorder.failure),
        faults=fault_log().faults,
        imu=None if telemetry.imu is None else replace(telemetry.imu),
        light_ahead=None if telemetry.light_ahead is None else replace(telemetry.light_ahead),
        tracking=None if telemetry.tracking is None else copy.deepcopy(telemetry.tracking),
        flicker_hz=telemetry.first_group.flicker_hz,
        requests=replace(telemetry.requests),
        groups={name: _group(tally) for name, tally in telemetry.groups.items()},
    )


def _group(tally: GroupTally) -> GroupStatus:
    return GroupStatus(
        cameras=tally.cameras,
        policy=tally.policy,
        decision=tally.decision,
        flicker_hz=tally.flicker_hz,
        requests=replace(tally.requests),
        decision_ms=_durations(tally.decision_ms),
    )


def _seconds(duration_ns: int) -> float:
    return round(duration_ns * 1e-9, 3)


def _camera(telemetry: Telemetry, name: CameraName) -> CameraStatus:
    camera = telemetry.cameras.names.get(name, GONE)
    return CameraStatus(
        camera=None if camera == GONE else camera,
        applied=telemetry.newest.get(name),
        drift_grey=telemetry.cameras.drift_grey.get(name),
        misfit=telemetry.cameras.misfits.get(name),
        ptp=telemetry.cameras.ptp.get(name),
        frames=telemetry.cameras.frames.get(name, 0),
        lost=telemetry.cameras.frames_lost.get(name, 0),
        temperature_c=telemetry.cameras.temperatures_c.get(name),
        link_mbps=telemetry.cameras.links_mbps.get(name),
    )


def _durations(measured: DurationSamples) -> DurationStatus:
    percentiles = measured.percentiles()
    return DurationStatus(measured.count, round(measured.sum_ms, 3), percentiles["p50"], percentiles["p99"])


def _publishing(tally: PublishTally, now_ns: int) -> PublishStatus:
    dropped = {str(reason): count for reason, count in list(tally.dropped.items())}
    listed, unlisted = dict(tally.consumers.listed(now_ns)), tally.consumers.unlisted(now_ns)
    return PublishStatus(tally.offered, tally.sent, dropped, tally.trouble, listed, unlisted)
