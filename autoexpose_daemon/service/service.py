"""The daemon as a process: one control thread at a time, its outlets, announcements, reloads, and death of a thread."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from rich.console import Console

from autoexpose_daemon.config.document import CameraConfig, Config, ImuConfig, PublishConfig
from autoexpose_daemon.control.picture.image import Region
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.messages.client import response_to_json
from autoexpose_daemon.messages.keys import response_key, rig_key
from autoexpose_daemon.runtime.daemon import ControlThread, Daemon
from autoexpose_daemon.runtime.inputs import AngularRate, ForetoldLight, Tracking
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.service.last_exposure import LastExposure
from autoexpose_daemon.service.logs import set_up_logging
from autoexpose_daemon.service.notify import Notifier
from autoexpose_daemon.service.stored_geometry import StoredGeometry
from autoexpose_daemon.status.describe import describe, health_of
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import Show, display, line_of
from autoexpose_daemon.status.states import Health, State
from autoexpose_daemon.status.telemetry import PublishTally
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName
from imaging.geometry import pose_in
from imaging.python310 import FutureTimeoutError

if TYPE_CHECKING:
    from autoexpose_daemon.recording.recorder import GroupRecorders, Recorder  # an extra

log = logging.getLogger(__name__)

_LEVELS = {
    State.STARTING: logging.INFO,
    State.EXPOSING: logging.INFO,
    State.DEGRADED: logging.WARNING,
    State.FAILED: logging.ERROR,
}
_STATUS_PERIOD_S = 1.0


class Announcer:
    """Follows one daemon after another; all methods are called on one thread, which is not the control thread."""

    def __init__(self, notifier: Notifier) -> None:
        self.health = Health(State.STARTING)
        self._notifier = notifier
        self._ready = False
        self._beat_ns = 0
        self._announced_s = 0.0

    def begin(self, daemon: Daemon, config: Config) -> None:
        """Follow this daemon from now on; it is starting."""
        self._daemon, self._config = daemon, config
        self.health = Health(State.STARTING)

    def look(self) -> None:
        """Judge the state and announce a change; the start is over at the first state that is exposing or degraded."""
        health = health_of(self._daemon.telemetry, self._config)
        if health.state is State.FAILED:  # the service handles it, and may recover
            health = self.health
        if health != self.health:
            self._announce(health)
        if not self._ready and health.state is not State.STARTING:
            self._ready = True
            self._notifier.ready()
        if time.monotonic() - self._announced_s >= _STATUS_PERIOD_S:
            self._notifier.status(f"{health}; {self._daemon.telemetry.brief(time.monotonic_ns())}")
            self.feed()

    def feed(self) -> None:
        """Feed the watchdog if the control thread has made progress since the last time."""
        self._announced_s = time.monotonic()
        if self._daemon.beat_ns != self._beat_ns:
            self._beat_ns = self._daemon.beat_ns
            self._notifier.alive()

    def reloading(self) -> None:
        """A reload begins; it ends with the next state that is exposing or degraded."""
        self._ready = False
        self._notifier.reloading()

    def failed(self, error: BaseException) -> None:
        """Announce the failure that ends the process."""
        self._daemon.telemetry.failed(error)
        self._announce(health_of(self._daemon.telemetry, self._config))

    def stopping(self) -> None:
        """Announce that the stop begins."""
        self._notifier.stopping()
        if self.health.state is not State.FAILED:
            self._notifier.status("stopping")

    def _announce(self, health: Health) -> None:
        self.health = health
        log.log(_LEVELS[health.state], "state %s", health)
        self._notifier.status(str(health))


def add_outlets(
    daemon: Daemon,
    config: Config,
    recorder: Recorder | GroupRecorders | None = None,
    geometry: StoredGeometry | None = None,
) -> Daemon:
    """Have a daemon record, if there is a recorder, and publish and use an IMU, if configured.

    `geometry` keeps what requests say of the cameras' geometry; without it, that is kept until the process ends.
    Without the Python packages for zenoh, the daemon keeps running and says so.
    """
    if config.motion.imu is not None:
        _add_imu(daemon, config.motion.imu)
    daemon.telemetry.recorder = recorder
    if recorder is not None:
        recorder.follow(config.trigger.rate_hz, config.publish or PublishConfig())
        for group in daemon.groups:
            if (own := recorder.of(group)) is None:
                log.warning("group %s is not recorded: it was not there when the recording began", group)
            else:
                daemon.outlets.append(partial(_record, own, daemon, group))
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
    daemon.follow("light_ahead", light)
    daemon.telemetry.light_ahead = light.tally
    tracking = Tracking(config.cameras, config.trigger.rate_hz, config.publish.stamping)
    daemon.follow("steering", tracking)
    daemon.telemetry.tracking = tracking.tally
    publisher = Publisher(
        config.publish,
        config.cameras,
        partial(_texts, daemon),
        light,
        partial((geometry or StoredGeometry(None)).ask, daemon),
        explain={group: partial(daemon.explain, group) for group in daemon.groups},
        tracking=tracking,
        calibrations=lambda: _of_all_groups(daemon, attrgetter("calibrations")),
    )
    daemon.outlets.append(publisher)
    daemon.telemetry.publishing = publisher.tally
    return daemon


def _record(recorder: Recorder, daemon: Daemon, group: str, step: ControlStep) -> None:
    """Take a group's step, which its loop has just made."""
    own, control = step.groups.get(group, step if not step.groups else None), daemon.groups[group]
    if own is not None and own.decision is not None and control.active.loop is not None:
        recorder.take(own, control.active.loop, len(control.cameras), control.active.tuning.calibrations)


def _add_imu(daemon: Daemon, config: ImuConfig) -> None:
    rate = AngularRate(config, daemon.telemetry.counts)
    daemon.telemetry.imu = rate.tally
    subscriber: AbstractContextManager[Any] | None = None
    try:
        from autoexpose_daemon.publish.inbound import ImuSubscriber  # noqa: PLC0415  an extra
    except ImportError as error:
        rate.no_source = _missing(error)
    else:
        subscriber = ImuSubscriber(config, rate)
    daemon.follow("angular_rate_rad_s", rate, subscriber)


def _missing(error: ImportError) -> str:
    return f"{error.name} is missing: pip install 'autoexpose-daemon[publish]'"


def _of_all_groups(daemon: Daemon, part: Callable[[Tuning], dict[CameraName, Any]]) -> dict[CameraName, Any]:
    """A part of the tuning of each group, by camera."""
    return {camera: it for group in daemon.groups.values() for camera, it in part(group.active.tuning).items()}


def _with_views(status: Status, daemon: Daemon) -> Status:
    """A status that also says where the cameras stand and what counts in their pictures."""
    geometries = _of_all_groups(daemon, attrgetter("calibrations"))
    regions: dict[CameraName, Region] = _of_all_groups(daemon, attrgetter("regions"))
    poses = {
        right: pose_in(left, geometries[left], geometries[right])
        for left, right in daemon.config.stereo_pairs.values()
        if {left, right} <= geometries.keys()
    }
    cameras = {
        name: replace(camera, pose=poses.get(name), region=regions[name].boxes if name in regions else ())
        for name, camera in status.cameras.items()
    }
    return replace(status, cameras=cameras)


def _texts(daemon: Daemon, last: bool) -> dict[str, str]:
    """The status and the response of each camera, by key; `last`: before the session closes."""
    status = _with_views(describe(daemon.telemetry, daemon.config, ending=last), daemon)
    vignettings = _of_all_groups(daemon, attrgetter("vignettings"))
    responses = {
        response_key(status.rig, camera): response_to_json(it, vignettings.get(camera))
        for camera, it in _of_all_groups(daemon, attrgetter("responses")).items()
    }
    return {rig_key(status.rig, "status"): status.to_json()} | responses


_TURN_S = 0.25
_TUNE_PATIENCE_S = 5.0
_DISK_PATIENCE_S = 1.0

Build = Callable[[Config, ExposureSetting | None], Daemon]
"""Makes the daemon for a configuration; it begins with the given setting, or with the configured one if None."""

NewConfig = Callable[[], Config | None]
"""Polled for a new configuration; raises ConfigurationError for an invalid one."""


def _none() -> None:
    return None


def run_until_stopped(
    service: Service, stop: threading.Event, console: Console, title: str, new_config: NewConfig = _none
) -> None:
    """Run a service with the live view, or with log lines without a terminal; raises what `Service.run` raises."""
    set_up_logging(console)
    with display(console, lambda: title) as show:
        service.run(stop, show, new_config)
    log.info("stopped: %s", line_of(service.status()))


class Service:
    """Runs the daemon for a checked configuration, and for those that replace it; `build` makes each daemon.

    `notifier` is told of readiness and state, `last_exposure` remembers the setting that the cameras begin with.
    """

    def __init__(
        self, config: Config, build: Build, notifier: Notifier | None = None, last_exposure: LastExposure | None = None
    ) -> None:
        self._build = build
        self._last_exposure = last_exposure or LastExposure(None)
        self._announcer = Announcer(notifier or Notifier(None))
        self._config = config
        self._former: Config | None = None  # that exposed: to fall back on if the cameras refuse the new one
        self._dead: list[BaseException] = []
        self.daemon = self._make(config)

    def run(self, stop: threading.Event, show: Show, new_config: NewConfig = _none) -> None:
        """Run until `stop` is set, showing the status four times a second.

        Raises Exception: whatever ended a thread: a daemon with a dead thread must not look alive.
        """
        former_hook, threading.excepthook = threading.excepthook, self._on_dead_thread
        ended = threading.Event()
        keeping = threading.Thread(target=self._keep_exposure, args=(ended,), name="last-exposure", daemon=True)
        self._begin()
        keeping.start()
        try:
            while not stop.wait(_TURN_S):
                self._look_for_failures()
                self._announcer.look()
                show(self.status)
                if self._announcer.health.state is not State.STARTING:
                    self._former = None
                self._look_for_reload(new_config)
        except BaseException as error:
            self._announcer.failed(error)
            raise
        finally:
            self._announcer.stopping()
            self._end()
            threading.excepthook = former_hook
            ended.set()
            keeping.join(_DISK_PATIENCE_S)
        self._raise_failure()

    def status(self) -> Status:
        """The present status of the daemon."""
        return describe(self.daemon.telemetry, self.daemon.config)

    def _keep_exposure(self, ended: threading.Event) -> None:
        """On a thread of its own: a disk that does not answer holds up neither the watchdog nor a stop."""
        while not ended.wait(_TURN_S):
            self._last_exposure.keep(self.daemon.telemetry, time.monotonic())
        self._last_exposure.save(time.monotonic())

    def _make(self, config: Config) -> Daemon:
        return self._build(config, self._last_exposure.recall(config.exposure.limits()))

    def _begin(self) -> None:
        self._announcer.begin(self.daemon, self._config)
        self._control = ControlThread(self.daemon)

    def _end(self) -> None:
        self._control.ask_to_stop()
        while not self._control.ended(_TURN_S):
            self._announcer.feed()

    def _on_dead_thread(self, args: Any) -> None:
        self._dead.append(args.exc_value or RuntimeError(f"{args.thread} died"))

    def _raise_failure(self) -> None:
        for error in (*self._dead, self._control.error):
            if error is not None:
                raise error

    def _look_for_failures(self) -> None:
        error = self._control.error
        if self._former is None or not isinstance(error, AutoexposeError):
            self._raise_failure()
            return
        log.warning("new configuration rejected, going back to the old one: %s", error)
        self._config, self._former = self._former, None
        self.daemon = self._make(self._config)
        self._begin()

    def _look_for_reload(self, new_config: NewConfig) -> None:
        try:
            config = new_config()
            if config is None:
                return
            self._announcer.reloading()
            if _same_cameras(config, self._config):
                self._tune(config)
                self._config = config
                log.info("new configuration in use; the cameras kept running")
            else:
                self._restart(config)
        except ConfigurationError as error:
            log.warning("new configuration rejected, keeping the old one: %s", error)
        except FutureTimeoutError:
            log.warning("control has begun with the new configuration and does not respond: it may still take effect")

    def _tune(self, config: Config) -> None:
        """Have control switch to a configuration; ConfigurationError if nothing has changed and nothing will."""
        taken = self.daemon.tune(Tuning(config))
        try:
            taken.result(_TUNE_PATIENCE_S)
        except FutureTimeoutError:
            if taken.cancel():
                raise ConfigurationError("control does not respond") from None
            taken.result(_TURN_S)  # begun at the last moment, and done in milliseconds

    def _restart(self, config: Config) -> None:
        log.info(
            "the new configuration changes cameras, trigger, image, transport, IMU or publishing: reopening all of them"
        )
        daemon = self._make(config)  # may raise while the old one still runs
        if requested := str(self.daemon.telemetry.requests):
            log.info("what was requested ends with it: %s", requested)
        self._end()
        self._raise_failure()
        self._former = self._former or self._config  # a second reload may come while the first one's cameras open
        self._config, self.daemon = config, daemon
        self._begin()


def _same_cameras(one: Config, other: Config) -> bool:
    """Whether the cameras, the IMU and publishing would be opened the same way."""

    opening = attrgetter("gain_scales", "trigger", "image", "transport", "motion", "publish")
    return bool(opening(one) == opening(other)) and _uncalibrated(one) == _uncalibrated(other)


def _uncalibrated(config: Config) -> list[tuple[CameraName, CameraConfig]]:
    """The cameras in their order, without the files that say nothing of how to open them."""
    return [(name, camera.model_copy(update={"calibration": None})) for name, camera in config.cameras.items()]
