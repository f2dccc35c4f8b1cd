"""The daemon as a service: its messages to systemd, reloads, and threads that die or hang."""

from __future__ import annotations

import contextlib
import os
import queue
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.request import new_request
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.last_exposure import LastExposure
from autoexpose_daemon.service.notify import Notifier
from autoexpose_daemon.service.service import Announcer, Service
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.states import State
from autoexpose_daemon.status.telemetry import Telemetry
from drivers.camera import Camera
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame
from tests.autoexpose_daemon.scripted import LONG_S, SHAPE, ScriptedRig, Session, TriggeredCamera, config
from tests.autoexpose_daemon.service.service_process import PATIENCE_S, Notifications, running_service, service_manager
from tests.autoexpose_daemon.stereo import stereo_cameras
from tests.calibration.geometry.written import ros, small_ros
from tests.drivers.rig.test_rig import ScriptedCamera

IMPOSSIBLE: list[tuple[dict[str, Any], str]] = [
    (
        {
            "exposure": {"min_gain_db": 90, "max_gain_db": 95},
            "control": {"start": {"exposure_time_us": 99, "gain_db": 90}},
        },
        "gain limits 90 to ",
    ),
    ({"control": {"roi": {"left": {"rectangles": [{"box": [0, 0, 9999, 10]}]}}}}, "9999"),
    ({"trigger": {"line": "Line9"}}, "Line9"),
]
"""What the cameras' limits, their frames, and what only an opened camera shows."""


class RunningService:
    """A service on scripted cameras; `reload` hands it what its configuration file would hold at a SIGHUP."""

    def __init__(self, rig: ScriptedRig, manager: Notifications, address: str) -> None:
        self.rig = rig
        self.manager = manager
        self.stop = threading.Event()
        self._files: queue.SimpleQueue[Config | ConfigurationError] = queue.SimpleQueue()
        self.service = Service(config(control={"policy": "fixed"}), self._build, Notifier(address))

    def run(self) -> None:
        self.service.run(self.stop, lambda _status: None, self._new_config)

    def reload(self, file: Config | ConfigurationError) -> None:
        self._files.put(file)

    def _build(self, wanted: Config, start: ExposureSetting | None) -> Daemon:
        cameras: dict[CameraName, TriggeredCamera] = {"left": self.rig.left, "right": self.rig.right}
        return Daemon(wanted, {camera: partial(_open, it, wanted) for camera, it in cameras.items()}, start=start)

    def _new_config(self) -> Config | None:
        if self._files.empty():
            return None
        file = self._files.get()
        if isinstance(file, ConfigurationError):
            raise file
        return file


def _open(camera: TriggeredCamera, wanted: Config) -> Camera:
    if wanted.trigger.line == "Line9":
        raise ConfigurationError("camera L: there is no Line9")
    return Session(camera)


@pytest.fixture
def running(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> Iterator[RunningService]:
    monkeypatch.setattr("autoexpose_daemon.service.service._STATUS_PERIOD_S", 0.1)
    monkeypatch.setattr("autoexpose_daemon.service.service._TURN_S", 0.05)
    caplog.set_level("INFO")
    with service_manager(lambda: caplog.text) as (manager, address), ScriptedRig(config().cameras) as rig:
        running = RunningService(rig, manager, address)
        thread = threading.Thread(target=running.run)
        thread.start()
        try:
            manager.wait_for("STATUS=exposing")
            yield running
        finally:
            running.stop.set()
            thread.join(LONG_S)


def wait_for_words(running: RunningService, log: pytest.LogCaptureFixture, words: str) -> None:
    """Until the log has them; the watchdog is fed meanwhile."""
    running.manager.wait_until(lambda _: words in log.text, words)


def test_a_stopped_trigger_and_a_lost_camera_degrade_and_feed_the_watchdog(running: RunningService) -> None:
    manager = running.manager
    running.rig.pauses = True
    manager.wait_for("STATUS=degraded: no triggers")
    manager.wait_for("WATCHDOG=1")
    running.rig.pauses = False
    manager.wait_for("STATUS=exposing")
    running.rig.right.lost = True
    manager.wait_until(lambda message: "right camera gone" in message, "the right camera being gone")
    manager.wait_for("WATCHDOG=1")
    running.rig.right.lost = False
    manager.wait_for("STATUS=exposing")
    running.stop.set()
    manager.wait_for("STOPPING=1")
    manager.wait_for("STATUS=stopping")
    assert manager.heard.count("READY=1") == 1


def test_the_exposure_of_one_camera_alone_is_remembered(running: RunningService) -> None:
    running.rig.right.lost = True
    running.manager.wait_until(lambda message: "right camera gone" in message, "the right camera being gone")
    running.reload(config(control={"policy": "fixed", "start": {"exposure_time_us": 777}}))
    limits, last = config().exposure.limits(), running.service._last_exposure

    def remembered(_message: str) -> bool:
        setting = last.recall(limits)
        return setting is not None and setting.agrees_with(ExposureSetting(777.0, 0.0))

    running.manager.wait_until(remembered, "the exposure of the left camera")


@pytest.mark.parametrize(("sections", "why"), IMPOSSIBLE)
def test_a_reload_that_cannot_be_leaves_all_as_it_was(
    running: RunningService, caplog: pytest.LogCaptureFixture, sections: dict[str, Any], why: str
) -> None:
    running.reload(config(**sections))
    wait_for_words(running, caplog, "configuration rejected")
    assert why in next(line for line in caplog.text.splitlines() if "configuration rejected" in line)
    running.manager.wait_until(lambda _: running.service.status().state is State.EXPOSING, "exposing again")


def test_two_reloads_in_a_row_go_back_to_what_has_exposed(
    running: RunningService, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("autoexpose_daemon.status.states.START_PATIENCE_NS", round(LONG_S * 1e9))
    running.rig.left.lost = running.rig.right.lost = True
    running.reload(config(trigger={"line": "Line8"}))
    running.manager.wait_for("STATUS=starting")
    running.reload(config(trigger={"line": "Line9"}))
    wait_for_words(running, caplog, "going back to the old one")
    running.rig.left.lost = running.rig.right.lost = False
    running.manager.wait_for("STATUS=exposing")
    assert running.service.daemon.tuning.config.trigger.line == "Line0"


def test_a_failure_that_is_not_over_when_it_is_seen_leaves_all_as_it_was(
    running: RunningService, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The telemetry says so before the control thread has closed the cameras and ended."""
    service, seen = running.service, threading.Event()
    look, close = service._announcer.look, Daemon._stop_rig

    def look_and_say_so() -> None:
        look()
        if service.daemon.telemetry.failure is not None:
            seen.set()

    def close_late(daemon: Daemon) -> None:
        if daemon.telemetry.failure is not None:
            seen.wait(LONG_S)
        close(daemon)

    monkeypatch.setattr(service._announcer, "look", look_and_say_so)
    monkeypatch.setattr(Daemon, "_stop_rig", close_late)
    running.reload(config(trigger={"line": "Line9"}))
    wait_for_words(running, caplog, "configuration rejected")
    running.manager.wait_until(lambda _: service.status().state is State.EXPOSING, "exposing again")


def test_a_reload_that_control_did_not_begin_in_time_is_rejected_for_good(
    running: RunningService, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("autoexpose_daemon.service.service._TUNE_PATIENCE_S", 0.1)
    free, stuck, daemon = threading.Event(), threading.Event(), running.service.daemon

    def hang(_step: ControlStep) -> None:
        stuck.set()
        assert free.wait(LONG_S)

    tuning = daemon.tuning
    daemon.outlets.append(hang)
    assert stuck.wait(LONG_S)
    try:
        running.reload(config(control={"policy": "fixed", "start": {"exposure_time_us": 777}}))
        wait_for_words(running, caplog, "rejected, keeping the old one: control does not respond")
    finally:
        free.set()
    daemon.ask(new_request({"by": "test", "locked": False})).result(LONG_S)  # comes after what waited before it
    assert daemon.tuning is tuning


def test_a_calibration_of_another_size_is_not_taken(
    running: RunningService, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    file = tmp_path / "left.yaml"
    cameras = {"left": {"serial": "L", "calibration": file}, "right": {"serial": "R"}}
    height, width = SHAPE
    file.write_text(yaml.safe_dump(small_ros("left", width, height)))
    running.reload(config(cameras=cameras))
    running.manager.wait_for("RELOADING=1")
    running.manager.wait_for("READY=1")
    assert running.service.daemon.tuning.calibrations["left"].width == width
    file.write_text(yaml.safe_dump(ros("left")))
    running.reload(config(cameras=cameras))
    wait_for_words(running, caplog, f"frames of 720x540 pixels, but camera L sends {width}x{height}")


def test_a_reload_of_control_leaves_the_cameras_open(running: RunningService) -> None:
    running.reload(config(control={"policy": "fixed", "start": {"exposure_time_us": 777}}))
    running.manager.wait_for("RELOADING=1")
    running.manager.wait_for("READY=1")
    running.manager.wait_until(lambda message: "777 us" in message, "the new exposure")
    assert (running.rig.left.starts, running.rig.right.starts) == (1, 1)


@pytest.mark.parametrize(
    "sections",
    [{"trigger": {"rate_hz": 60.001}}, {"motion": {"imu": {"key": "imu/data"}}, "control": {"focal_length_px": 800}}],
)
def test_a_reload_of_trigger_or_imu_opens_the_cameras_again(running: RunningService, sections: dict[str, Any]) -> None:
    running.reload(config(**sections))
    running.manager.wait_for("RELOADING=1")
    running.manager.wait_for("READY=1")
    assert (running.rig.left.starts, running.rig.right.starts) == (2, 2)


def test_a_start_that_cannot_be_is_told_and_is_not_worth_another(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("cameras: {left: {serial: A}}\nexposure: {max_time: 1}")
    with running_service(file) as service:
        assert "exposure.max_time: unknown key" in service.wait_for("STATUS=failed: ")
        assert service.process.wait(PATIENCE_S) == os.EX_CONFIG
        assert service.log.splitlines()[-1].startswith("autoexpose: ")
        assert "Traceback" not in service.log


@pytest.mark.wire
def test_a_process_is_ready_reloads_and_stops(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    with stereo_cameras("--still") as (left, right, _), contextlib.ExitStack() as stack:
        rig = {"cameras": {"left": {"serial": left.serial}, "right": {"serial": right.serial}}}
        file.write_text(yaml.safe_dump(rig))
        service = stack.enter_context(running_service(file))
        service.wait_for("READY=1")
        file.write_text(yaml.safe_dump({**rig, "exposure": {"max_time": 1}}))
        service.reload()
        service.wait_until(lambda _: "configuration rejected" in service.log, "a refusal")
        assert "exposure.max_time: unknown key" in service.log
        file.unlink()
        os.mkfifo(file)  # opening it would wait for a writer
        service.reload()
        service.wait_until(lambda _: "a named pipe, not a regular file" in service.log, "a refusal of the pipe")
        file.unlink()
        file.write_text(yaml.safe_dump({**rig, "control": {"policy": "fixed", "start": {"exposure_time_us": 777}}}))
        service.reload()
        service.wait_for("RELOADING=1")
        service.wait_for("READY=1")
        service.wait_until(lambda message: "777 us" in message, "the new exposure")
        assert service.log.count(", ready") == 2
        assert service.stop() == 0
        service.wait_for("STOPPING=1")


CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})


class DyingCamera(ScriptedCamera):
    def __init__(self, where: str) -> None:
        super().__init__()
        self._where = where

    def next_frame(self, timeout_s: float) -> Frame | None:
        if self._where == "frames":
            raise RuntimeError("died in frames")
        return super().next_frame(timeout_s)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        if self._where == "write":
            raise RuntimeError("died in write")
        return super().write(setting)

    def close(self) -> None:
        super().close()
        if self._where == "close":
            raise RuntimeError("died in close")


def opener_that_dies() -> Camera:
    raise RuntimeError("died in open")


def build(right: Callable[[], Camera]) -> Service:
    openers: dict[CameraName, Callable[[], Camera]] = {"left": ScriptedCamera, "right": right}
    return Service(CONFIG, lambda config, start: Daemon(config, openers, start=start))


def show_nothing(_status: Callable[[], Status]) -> None:
    return


@pytest.mark.parametrize("where", ["open", "write", "frames", "close"])
def test_a_dead_thread_of_the_rig_ends_the_service(where: str) -> None:
    camera = DyingCamera(where)
    camera.lost = where == "close"
    service = build(opener_that_dies if where == "open" else lambda: camera)
    with pytest.raises(RuntimeError, match=f"died in {where}"):
        service.run(threading.Event(), show_nothing)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith(("control", "nodes", "frames"))]


def test_no_thread_blocks_the_others_for_as_long_as_a_decision_takes() -> None:
    sys.setswitchinterval(0.005)
    stop = threading.Event()
    stop.set()
    Daemon(CONFIG, {"left": ScriptedCamera, "right": ScriptedCamera}).run(stop)
    assert sys.getswitchinterval() < 0.001


def test_triggers_count_from_the_start_of_the_daemon_not_from_its_making() -> None:
    """On a reload the old daemon may still take them meanwhile."""
    daemon, stop = Daemon(CONFIG, {"left": ScriptedCamera, "right": ScriptedCamera}), threading.Event()
    before_ns = time.monotonic_ns()
    stop.set()
    daemon.run(stop)
    assert daemon.tally.window_start_ns is not None
    assert daemon.tally.window_start_ns >= before_ns


def test_a_dead_control_thread_ends_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    def die(_daemon: Daemon) -> None:
        raise ZeroDivisionError("died in control")

    monkeypatch.setattr(Daemon, "_warm_up", die)
    with pytest.raises(ZeroDivisionError, match="died in control"):
        build(ScriptedCamera).run(threading.Event(), show_nothing)


class StuckDisk(LastExposure):
    """Is asked to keep an exposure, and does not answer before it is `freed`."""

    def __init__(self) -> None:
        super().__init__(None)
        self.asked, self.freed = threading.Event(), threading.Event()

    def keep(self, telemetry: Telemetry, now_s: float) -> None:
        del telemetry, now_s
        self.asked.set()
        self.freed.wait(LONG_S)


def test_a_disk_that_does_not_answer_holds_up_no_stop() -> None:
    disk, stop = StuckDisk(), threading.Event()
    openers: dict[CameraName, Callable[[], Camera]] = {"left": ScriptedCamera, "right": ScriptedCamera}
    service = Service(CONFIG, lambda config, start: Daemon(config, openers, start=start), last_exposure=disk)
    thread = threading.Thread(target=service.run, args=(stop, show_nothing))
    thread.start()
    assert disk.asked.wait(LONG_S)
    stop.set()
    thread.join(LONG_S)
    assert not disk.freed.is_set()
    assert not thread.is_alive()
    disk.freed.set()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as listener:
        listener.bind(str(tmp_path / "notify"))
        yield listener


def heard(manager: socket.socket) -> list[str]:
    messages: list[str] = []
    while True:
        try:
            messages.append(manager.recv(4096).decode())
        except BlockingIOError:
            return messages


def test_a_stuck_control_thread_starves_the_watchdog(manager: socket.socket) -> None:
    stuck, free, stop = threading.Event(), threading.Event(), threading.Event()

    def hang(_step: ControlStep) -> None:
        stuck.set()
        assert free.wait(LONG_S)

    camera = ScriptedCamera(shape=(90, 120))
    config = Config.model_validate({"cameras": {"left": {"serial": "L"}}, "control": {"policy": "fixed"}})
    daemon = Daemon(config, {"left": lambda: camera}, outlets=[hang])
    announcer = Announcer(Notifier(manager.getsockname()))
    announcer.begin(daemon, config)
    thread = threading.Thread(target=daemon.run, args=(stop,))
    thread.start()
    try:
        camera.expose()
        assert stuck.wait(LONG_S)
        announcer.feed()
        assert heard(manager) == ["WATCHDOG=1"]
        announcer.feed()
        assert heard(manager) == []
    finally:
        free.set()
        stop.set()
        thread.join()


def test_a_state_is_reported_once_and_readiness_with_the_first_after_starting(
    manager: socket.socket, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    daemon = Daemon(CONFIG, {"left": ScriptedCamera, "right": ScriptedCamera})
    announcer = Announcer(Notifier(manager.getsockname()))
    announcer.begin(daemon, CONFIG)
    announcer.look()
    assert "READY=1" not in heard(manager)
    daemon.telemetry.last_pair_ns = 0
    announcer.look()
    announcer.look()
    assert announcer.health.state is State.DEGRADED
    announcer.failed(RuntimeError("died"))
    messages = heard(manager)
    assert messages.count("READY=1") == 1
    assert messages[-1] == "STATUS=failed: died"
    assert [record.message for record in caplog.records] == [
        "state degraded: left camera gone; right camera gone",
        "state failed: died",
    ]
