"""Threads that die or hang, on scripted cameras."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.notify import Notifier
from autoexpose_daemon.service.service import Announcer, Service
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.states import State
from drivers.camera import Camera
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side
from tests.drivers.rig.test_rig import ScriptedCamera

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})
LONG_S = 10.0


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
    openers: dict[Side, Callable[[], Camera]] = {"left": ScriptedCamera, "right": right}
    return Service(CONFIG, lambda config, start: Daemon(config, openers, start=start))


def show_nothing(_status: Callable[[], Status]) -> None:
    return


@pytest.mark.parametrize(
    ("right", "message"),
    [
        (opener_that_dies, "died in open"),
        (lambda: DyingCamera("write"), "died in write"),
        (lambda: DyingCamera("frames"), "died in frames"),
    ],
)
def test_a_dead_thread_of_the_rig_ends_the_service(right: Callable[[], Camera], message: str) -> None:
    service = build(right)
    with pytest.raises(RuntimeError, match=message):
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


def test_a_dead_camera_whose_closing_fails_ends_the_service() -> None:
    camera = DyingCamera("close")
    camera.lost = True
    with pytest.raises(RuntimeError, match="died in close"):
        build(lambda: camera).run(threading.Event(), show_nothing)


def test_a_dead_control_thread_ends_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    def die(_daemon: Daemon) -> None:
        raise ZeroDivisionError("died in control")

    monkeypatch.setattr(Daemon, "_warm_up", die)
    with pytest.raises(ZeroDivisionError, match="died in control"):
        build(ScriptedCamera).run(threading.Event(), show_nothing)


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
