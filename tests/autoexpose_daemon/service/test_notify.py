from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from autoexpose_daemon.service.notify import Notifier
from tests.fakes import unique


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@{unique('notify')}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(address.replace("@", "\0", 1))
        listener.settimeout(5)
        yield listener, address


def test_each_message_is_as_sd_notify_has_it(manager: tuple[socket.socket, str]) -> None:
    listener, address = manager
    notifier = Notifier(address)
    before_us = time.monotonic_ns() // 1000
    notifier.ready()
    notifier.reloading()
    notifier.alive()
    notifier.stopping()
    assert listener.recv(99) == b"READY=1"
    reloading, monotonic = listener.recv(99).split(b"\n")
    assert reloading == b"RELOADING=1"
    assert before_us <= int(monotonic.removeprefix(b"MONOTONIC_USEC=")) <= time.monotonic_ns() // 1000
    assert listener.recv(99) == b"WATCHDOG=1"
    assert listener.recv(99) == b"STOPPING=1"


def test_a_status_is_one_line_and_is_not_said_twice(manager: tuple[socket.socket, str]) -> None:
    listener, address = manager
    notifier = Notifier(address)
    for text in ("exposing", "exposing", "failed:\nno camera"):
        notifier.status(text)
    assert listener.recv(99) == b"STATUS=exposing"
    assert listener.recv(99) == b"STATUS=failed: no camera"


def test_a_status_may_name_a_file_whose_name_is_no_text(manager: tuple[socket.socket, str]) -> None:
    listener, address = manager
    Notifier(address).status(f"failed: {os.fsdecode(b'rig-%s.yaml' % bytes([0xFF]))}: cannot be read")
    assert listener.recv(99) == rb"STATUS=failed: rig-\udcff.yaml: cannot be read"


def test_what_this_process_starts_does_not_speak_for_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    notifier = Notifier.from_environment()
    assert "NOTIFY_SOCKET" not in os.environ
    notifier.ready()  # no listener is not an error


def test_a_manager_that_does_not_read_holds_nothing_up(
    manager: tuple[socket.socket, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("autoexpose_daemon.service.notify._PATIENCE_S", 0.001)
    listener, address = manager
    notifier = Notifier(address)
    for _ in range(100):  # far more than a socket's queue holds
        notifier.alive()
    assert listener.recv(99) == b"WATCHDOG=1"
