"""What `autoexpose top` shows; the daemon is a publisher with a status made up."""

from __future__ import annotations

import contextlib
import io
import math
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest
from rich.console import Console
from rich.table import Table

from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.client.top import Sparklines, follow, no_status, show_once, sparkline
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.messages.keys import status_key
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.status.document import Fault, Status
from imaging.errors import AutoexposeError
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.statuses import EXPOSING
from tests.fakes import loopback_address
from tests.meanwhile import meanwhile

pytestmark = pytest.mark.usefixtures("brisk")

CODES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


class Screen(io.StringIO):
    @property
    def text(self) -> str:
        return CODES.sub("", self.getvalue())


@contextlib.contextmanager
def daemon(status: Status, at: str) -> Iterator[None]:
    def tell(last: bool) -> dict[str, str]:
        said = replace(status, unix_time_s=time.time(), ending=last)
        return {status_key(status.rig): said.to_json()}

    with Publisher(PublishConfig(rig=status.rig, listen=(at,)), 2, tell):
        yield


@pytest.mark.parametrize("metric", [math.nan, math.inf, 1e308])
def test_a_metric_that_is_no_number_is_left_out_of_the_curves(metric: float) -> None:
    assert EXPOSING.decision is not None
    curves, table = Sparklines(), Table()
    for at_s, value in enumerate((metric, 0.5, -metric)):
        odd = replace(EXPOSING.decision, metric=value)
        curves.add(replace(EXPOSING, unix_time_s=float(at_s), decision=odd))
    curves.add_rows(table)
    assert table.row_count == 3


def screen_of(terminal: bool = True) -> tuple[Screen, Console]:
    screen = Screen()
    return screen, Console(file=screen, force_terminal=terminal, width=120, height=50, _environ={})


@pytest.mark.wire
def test_the_moment_is_printed_once() -> None:
    at = endpoint()
    screen, console = screen_of(terminal=False)
    hostile = Fault(0.0, "WARNING", "left camera: \x1b]0;gone\x07 [red]away[/red]")
    with daemon(replace(EXPOSING, faults=(hostile,)), at):
        show_once("rig", [at], console)
    for text in (
        "autoexpose rig, belief, up 2 h 1 min",
        "exposing",
        "FakeCam L1   1000 us, 6.0 dB",
        "3 without the left frame; 20 before every camera was open",
    ):
        assert text in screen.text
    assert "left camera: ?]0;gone? [red]away[/red]" in screen.text


@pytest.mark.wire
def test_it_follows_a_daemon_and_says_when_that_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autoexpose_daemon.client.top._SILENT_S", 1.0)
    at = endpoint()
    screen, console = screen_of()
    with meanwhile(lambda stop: follow("rig", [at], console, stop)):
        wait_until(lambda: f"no answer from {at}" in screen.text, "the complaint")
        with daemon(EXPOSING, at):
            wait_until(lambda: "exposure, us" in screen.text, "curves")
        wait_until(lambda: "ended 1 s ago" in screen.text, "the silence to be noticed")


def test_nobody_there_is_said_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """However little time a busy machine has left for the attempt to connect."""
    monkeypatch.setattr("autoexpose_daemon.client.top._PATIENCE_S", 0.1)
    at = endpoint()
    with pytest.raises(AutoexposeError, match=f"no answer from {at}.*`publish: {{rig: scout}}` in its config"):
        show_once("scout", [at], screen_of()[1])


@pytest.mark.wire
def test_a_daemon_of_another_rig_is_not_the_one_asked_for() -> None:
    at = endpoint()
    with daemon(EXPOSING, at), StatusClient("scout", [at]) as client:
        wait_until(lambda: not client.trouble, "a connection")
        assert f"no status from a rig named scout at {at}" in no_status(client, "scout", [at])


def test_without_a_terminal_it_names_the_way() -> None:
    with pytest.raises(AutoexposeError, match="add --once"):
        follow("rig", [f"tcp/{loopback_address()}:1"], screen_of(terminal=False)[1], threading.Event())


def test_a_curve_spans_its_range() -> None:
    assert sparkline([0.0, 1.0, 7.0]) == "\u2581\u2582\u2588"
    assert sparkline([3.0, 3.0]) == "\u2581\u2581"
