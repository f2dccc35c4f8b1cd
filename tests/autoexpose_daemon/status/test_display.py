from __future__ import annotations

import io
import itertools
import logging
from dataclasses import replace

import pytest
from rich.console import Console

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import display, table_of
from autoexpose_daemon.status.telemetry import CameraTally, Telemetry
from tests.autoexpose_daemon.statuses import EXPOSING

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}}})


def degraded() -> Status:
    return describe(Telemetry(cameras=CameraTally({"left": "Camera L"}), opened_ns=0, last_pair_ns=0), CONFIG)


def test_without_a_terminal_the_log_gets_a_line_ever_more_seldom(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    now_s = 0
    monkeypatch.setattr("autoexpose_daemon.status.panel.time.monotonic", lambda: now_s)
    said_s: list[int] = []
    with display(Console(file=io.StringIO()), str) as show:
        for now_s in range(12 * 3600):
            show(degraded)
            if len(caplog.records) > len(said_s):
                said_s.append(now_s)
    assert said_s[:3] == [5, 15, 35]
    assert [later - earlier for earlier, later in itertools.pairwise(said_s)][-3:] == [3600, 3600, 3600]


def test_a_terminal_shows_which_flicker_was_found() -> None:
    for flicker_hz, shown in ((120.0, True), (None, False)):
        screen = io.StringIO()
        Console(file=screen, width=100).print(table_of(replace(EXPOSING, flicker_hz=flicker_hz)))
        assert ("120 Hz" in screen.getvalue()) == shown


def test_a_terminal_shows_the_state() -> None:
    screen = io.StringIO()
    with display(Console(file=screen, force_terminal=True, width=100), lambda: "autoexpose") as show:
        show(degraded)
    assert "degraded: no triggers" in screen.getvalue()
