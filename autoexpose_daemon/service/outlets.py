"""The outlets of a daemon's control steps, and the source of its angular rate, as configured."""

from __future__ import annotations

import logging
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.motion import ImuConfig
from autoexpose_daemon.config.publish import PublishConfig
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.keys import response_key, status_key
from autoexpose_daemon.messages.response import response_to_json
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.inputs.angular_rate import AngularRate
from autoexpose_daemon.runtime.inputs.foretold_light import ForetoldLight
from autoexpose_daemon.runtime.inputs.tracking import Tracking
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.publishing import PublishTally
from imaging.frames import StereoPair

if TYPE_CHECKING:
    from autoexpose_daemon.recording.recorder import Recorder  # an extra

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RecorderTap:
    """A recorder as the outlet of one daemon, which it outlives."""

    recorder: Recorder
    daemon: Daemon
    cameras: int

    def __call__(self, pair: StereoPair, decision: Decision | None) -> None:
        """Record a step and the loop that has just made it; a pair without a decision is not a step."""
        if decision is not None and self.daemon.loop is not None:
            requests, calibrations = self.daemon.fresh_requests, self.daemon.tuning.calibrations
            self.recorder.take(pair, decision, self.daemon.loop, self.cameras, requests, calibrations=calibrations)


def add_outlets(daemon: Daemon, config: Config, recorder: Recorder | None = None) -> Daemon:
    """Have a daemon record, if there is a recorder, and publish and use an IMU, if configured.

    Without the Python packages for zenoh, the daemon keeps running and says so.
    """
    if config.motion.imu is not None:
        _add_imu(daemon, config.motion.imu)
    daemon.telemetry.recorder = recorder
    if recorder is not None:
        recorder.follow(config.trigger.rate_hz, config.publish or PublishConfig())
        daemon.outlets.append(RecorderTap(recorder, daemon, len(config.sides)))
    if config.publish is None:
        return daemon
    try:
        from autoexpose_daemon.publish.publisher import Publisher  # noqa: PLC0415  an extra
    except ImportError as error:
        trouble = _missing(error)
        log.warning("frames are not published: %s", trouble)
        daemon.telemetry.publishing = PublishTally(trouble=trouble)
        return daemon
    light = ForetoldLight(config.trigger.rate_hz)
    daemon.follow_light(light)
    tracking = Tracking(config.sides, config.trigger.rate_hz)
    daemon.follow_tracking(tracking)
    publisher = Publisher(
        config.publish,
        len(config.sides),
        partial(_texts, daemon),
        light,
        daemon.ask,
        explain=daemon.explain,
        tracking=tracking,
        calibrations=lambda: daemon.tuning.calibrations,
    )
    daemon.outlets.append(publisher)
    daemon.telemetry.publishing = publisher.tally
    return daemon


def _add_imu(daemon: Daemon, config: ImuConfig) -> None:
    rate = AngularRate(config, daemon.telemetry.counts)
    daemon.telemetry.imu = rate.tally
    subscriber: AbstractContextManager[Any]
    try:
        from autoexpose_daemon.publish.imu import ImuSubscriber  # noqa: PLC0415  an extra
    except ImportError as error:
        subscriber, rate.no_source = nullcontext(), _missing(error)
    else:
        subscriber = ImuSubscriber(config, rate)
    daemon.follow_imu(subscriber, rate)


def _missing(error: ImportError) -> str:
    return f"{error.name} is missing: pip install 'autoexpose-daemon[publish]'"


def _texts(daemon: Daemon, last: bool) -> dict[str, str]:
    """The status and the response of each camera, by key; `last`: before the session closes."""
    tuning = daemon.tuning
    status = describe(daemon.telemetry, tuning.config, ending=last)
    responses = {
        response_key(status.rig, side): response_to_json(it, tuning.vignettings.get(side))
        for side, it in tuning.responses.items()
    }
    return {status_key(status.rig): status.to_json()} | responses
