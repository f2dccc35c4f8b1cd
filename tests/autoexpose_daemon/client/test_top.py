"""Which rig is worse than which, and what `autoexpose top` shows of one rig or of all; routers are real."""

from __future__ import annotations

import io
import json
import math
import re
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from rich.table import Table

from autoexpose_daemon.client.status_client import MOST_RIGS, Condition, Fleet, FleetClient, RigLine, StatusClient
from autoexpose_daemon.client.top import (
    Sparklines,
    follow,
    follow_all,
    no_status,
    panel_of,
    panel_of_all,
    show_all_once,
    show_once,
    sparkline,
    summary,
    table_of_all,
)
from autoexpose_daemon.messages.keys import rig_key
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.status.counters import Counts
from autoexpose_daemon.status.document import Fault, Status
from autoexpose_daemon.status.panel import line_of
from autoexpose_daemon.status.states import State
from imaging.errors import AutoexposeError
from tests import REPOSITORY
from tests.autoexpose_daemon.publish.processes import QUIET, router, router_file
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, telling, wait_until
from tests.autoexpose_daemon.samples import EXPOSING, GROUPED
from tests.fakes import loopback_address
from tests.meanwhile import meanwhile

SILENT_S = 5.0


def status(
    rig: str, state: State = State.EXPOSING, pairs: int = 1000, missing: int = 0, ending: bool = False
) -> Status:
    reasons = ("no triggers",) if state is State.DEGRADED else ()
    lost = {"left_missing": missing, "startup": 500 * missing}
    counts = Counts(pairs=pairs)
    return replace(EXPOSING, rig=rig, state=state, reasons=reasons, counts=counts, lost=lost, ending=ending)


def fleet_of(*statuses: Status, at_s: float = 0.0) -> Fleet:
    fleet = Fleet(SILENT_S)
    for said in statuses:
        assert fleet.take(said.rig, said, at_s)
    return fleet


def only(fleet: Fleet, now_s: float) -> RigLine:
    (line,) = fleet.lines(now_s)
    return line


def test_the_worst_comes_first() -> None:
    fleet = fleet_of(status("quiet"))
    for said in (
        status("fine"),
        status("also_fine"),
        status("beginning", State.STARTING),
        status("stopped", ending=True),
        status("loser", pairs=0),
        status("loser", pairs=900, missing=20),
        status("sad_loser", pairs=0),
        status("sad_loser", pairs=900, missing=40),
        status("halting", State.DEGRADED),
        status("broken", State.FAILED, ending=True),
    ):
        assert fleet.take(said.rig, said, 10.0)
    lines = fleet.lines(11.0)
    assert [line.rig for line in lines] == [
        *("broken", "quiet", "halting", "sad_loser", "loser", "stopped", "beginning", "also_fine", "fine")
    ]
    assert list(dict.fromkeys(line.condition for line in lines)) == list(Condition)


def test_a_rig_that_falls_silent_stays_with_its_age_and_what_it_said_last() -> None:
    fleet = fleet_of(status("scout", State.DEGRADED))
    assert only(fleet, SILENT_S).condition is Condition.DEGRADED
    line = only(fleet, 7000.0)
    assert (line.condition, line.age_s, line.why) == (Condition.SILENT, 7000.0, "degraded before: no triggers")
    fleet.take("scout", status("scout"), 7001.0)
    assert only(fleet, 7001.0).condition is Condition.EXPOSING


@pytest.mark.parametrize(("state", "condition"), [(State.EXPOSING, Condition.ENDED), (State.FAILED, Condition.FAILED)])
def test_a_rig_that_said_it_ends_is_not_silent(state: State, condition: Condition) -> None:
    assert only(fleet_of(status("scout", state, ending=True)), 7000.0).condition is condition


def test_losses_are_judged_by_the_last_minute_and_only_those_that_are_faults() -> None:
    fleet = fleet_of(status("scout", pairs=0, missing=1000))
    assert only(fleet, 0.0).lost_share == 0.0  # when it lost them, nobody knows
    for second in range(1, 31):
        fleet.take("scout", status("scout", pairs=60 * second, missing=1000 + second), float(second))
    losing = only(fleet, 31.0)
    assert (losing.condition, losing.lost) == (Condition.LOSING, 1030)
    assert losing.lost_share == pytest.approx(1 / 61)
    assert losing.why == "1030 without the left frame; 515000 before every camera was open"
    for second in range(31, 100):
        fleet.take("scout", status("scout", pairs=60 * second, missing=1030), float(second))
    assert only(fleet, 100.0).lost_share == 0.0


def test_counters_that_begin_again_are_no_losses() -> None:
    fleet = fleet_of(status("scout", pairs=1000, missing=7))
    fleet.take("scout", status("scout", pairs=30, missing=2), 1.0)
    assert only(fleet, 1.0).lost_share == 0.0
    fleet.take("scout", status("scout", pairs=128, missing=4), 2.0)
    assert only(fleet, 2.0).lost_share == pytest.approx(0.02)


def test_what_strangers_send_takes_no_more_room_than_it_may() -> None:
    fleet = fleet_of(status("scout", pairs=0))
    for number in range(1, 2001):
        fleet.take("scout", status("scout", pairs=number, missing=number), number / 1000)
    assert len(fleet._rigs["scout"].counts) <= 4, "many within a second"
    assert only(fleet, 2.0).lost_share == pytest.approx(0.5)
    said = replace(status("scout", State.DEGRADED), reasons=("x" * 100_000,), lost={"y" * 100_000: 1})
    known = fleet_of(said)._rigs["scout"]
    assert max(len(known.reasons), len(known.lost_words)) <= 300


@pytest.mark.parametrize("rig", ["", "1st", "a b", "\x1b[2J", "*", "x" * 101])
def test_a_key_that_names_no_rig_or_another_one_is_passed_over(rig: str) -> None:
    fleet = fleet_of(status("scout"))
    assert not fleet.take(rig, replace(EXPOSING, rig=rig), 1.0)
    assert not fleet.take("scout", status("mule", State.FAILED), 1.0)
    assert only(fleet, 1.0).condition is Condition.EXPOSING


def test_the_list_is_bounded_and_those_that_are_on_it_stay() -> None:
    fleet = fleet_of(*(status(f"rig_{number}") for number in range(MOST_RIGS)))
    assert not fleet.crowded(1.0)
    assert not fleet.take("one_too_many", status("one_too_many"), 1.0)
    assert fleet.take("rig_0", status("rig_0"), 1.0)
    assert fleet.crowded(2.0)
    assert not fleet.crowded(100.0)
    assert "one_too_many" not in {line.rig for line in fleet.lines(2.0)}


CODES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


class Screen(io.StringIO):
    @property
    def text(self) -> str:
        return CODES.sub("", self.getvalue())


def daemon(status: Status, at: str, *connect: str) -> Publisher:
    """That listens at `at`, and connects to a router."""

    def tell(last: bool) -> dict[str, str]:
        said = replace(status, unix_time_s=time.time(), ending=last)
        return {rig_key(status.rig, "status"): said.to_json()}

    return telling(at, tell, status.rig, connect)


@pytest.mark.parametrize("metric", [math.nan, math.inf, 1e308])
def test_a_metric_that_is_no_number_is_left_out_of_the_curves(metric: float) -> None:
    assert EXPOSING.decision is not None
    curves, table = Sparklines(), Table()
    for at_s, value in enumerate((metric, 0.5, -metric)):
        odd = replace(EXPOSING.decision, metric=value)
        curves.add(replace(EXPOSING, unix_time_s=float(at_s), decision=odd))
    curves.add_rows(table, 120)
    assert table.row_count == 3


@pytest.mark.parametrize("width", [80, 120])
def test_a_curve_keeps_to_its_line(width: int) -> None:
    curves = Sparklines()
    for at_s in range(100):
        curves.add(replace(EXPOSING, unix_time_s=float(at_s)))
    rows = printed(panel_of(EXPOSING, curves, 0.0, 50, width), width=width).splitlines()
    (gain,) = [row for row in rows if "gain, dB" in row]
    assert "6.0" in gain
    assert 10 <= gain.count("\u2581") <= 60
    assert sum("\u2581" in row for row in rows) == 3  # exposure, gain and metric


def test_each_group_has_a_line_and_curves_of_its_own() -> None:
    curves = Sparklines()
    curves.add(EXPOSING)
    curves.add(replace(GROUPED, unix_time_s=2e9))  # after a reload
    rows = [
        " ".join(row.strip("\u2502").split()) for row in printed(panel_of(GROUPED, curves, 0.0, 50, 160)).splitlines()
    ]
    assert "belief and neves2009" in rows[0]
    (front,) = [row for row in rows if row.startswith("group front")]
    (rear,) = [row for row in rows if row.startswith("group rear")]
    for line, words in (
        (front, ("belief", "E 10.97", "2200 us, 3.0 dB: seen by belief", "saturated 3% black 4%")),
        (rear, ("neves2009", "E 8.23", "310 us, 3.0 dB: seen by neves2009", "requested: EV -1")),
    ):
        assert [word for word in words if word not in line] == []
    assert sum(row.startswith(("front: exposure, us", "rear: exposure, us")) for row in rows) == 2
    assert not [row for row in rows if row.startswith(("exposure, us", "exposure level", "decision held"))]
    for row in ("front_left camera FakeCam A 2000 us, 0.0 dB", "rear_left camera FakeCam C lost: 100"):
        assert row in rows
    assert "lost 90 without the rear_left frame, 10 without several frames" in rows


def test_a_line_of_the_log_tells_of_each_group() -> None:
    line = line_of(GROUPED)
    assert "; front 2000 us, 0.0 dB; metric 0.1100; " in line
    assert "; rear 300 us, 0.0 dB; metric 0.2200; requested: EV -1; " in line
    assert "1000 us, 6.0 dB" in line_of(EXPOSING)


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


@pytest.mark.wire
def test_a_daemon_of_another_rig_is_not_the_one_asked_for() -> None:
    at = endpoint()
    with daemon(EXPOSING, at), StatusClient("scout", [at]) as client:
        wait_until(lambda: not client.trouble, "a connection")
        assert f"no status from a rig named scout at {at}" in no_status(client)


def test_without_a_terminal_it_names_the_way() -> None:
    with pytest.raises(AutoexposeError, match="add --once"):
        follow("rig", [f"tcp/{loopback_address()}:1"], screen_of(terminal=False)[1], threading.Event())


def test_a_curve_spans_its_range() -> None:
    assert sparkline([0.0, 1.0, 7.0]) == "\u2581\u2582\u2588"
    assert sparkline([3.0, 3.0]) == "\u2581\u2581"


FLEETS = REPOSITORY / "docs/do/fleets.md"


def printed(*parts: object, width: int = 160) -> str:
    screen = Screen()
    Console(file=screen, width=width, height=50, _environ={}).print(*parts)
    return screen.text


def conditions(client: FleetClient, now_s: float) -> dict[str, Condition]:
    return {line.rig: line.condition for line in client.fleet.lines(now_s)}


def line(name: str, condition: Condition = Condition.EXPOSING, why: str = "") -> RigLine:
    return RigLine(name, condition, why, 12.3, 60.0, 3, 0.004, EXPOSING.cameras["left"].applied)


def test_a_rig_is_one_line() -> None:
    lines = [
        line("broken", Condition.FAILED, "no such camera"),
        line("quiet", Condition.SILENT, "exposing before"),
        line("loser", Condition.LOSING, "3 without the left frame"),
        line("stopped", Condition.ENDED),
        line("fine"),
    ]
    rows = [" ".join(row.split()) for row in printed(table_of_all(lines)).splitlines()]
    assert rows == [
        "rig state pairs/s lost last minute exposure why",
        "broken failed, 12 s ago 3 1000 us, 6.0 dB no such camera",
        "quiet silent for 12 s 3 1000 us, 6.0 dB exposing before",
        "loser losing triggers 60.0 3 0.4% 1000 us, 6.0 dB 3 without the left frame",
        "stopped ended, 12 s ago 3 1000 us, 6.0 dB",
        "fine exposing 60.0 3 0.4% 1000 us, 6.0 dB",
    ]
    assert summary(lines) == "5 rigs: 1 failed, 1 silent, 1 losing triggers, 1 ended, 1 exposing"


def test_what_a_stranger_writes_commands_no_terminal_and_breaks_no_line() -> None:
    hostile = line("x" * 100, Condition.DEGRADED, "\x1b]0;gone\x07 [red]away[/red]\n\r" + "\u4e2d" * 400)
    text = printed(table_of_all([hostile]), width=160)
    assert "?]0;gone? [red]away[/red]" in text
    assert "\x1b" not in text
    assert len(text.splitlines()) == 2


def test_a_narrow_terminal_shortens_the_reasons_first() -> None:
    rows = printed(table_of_all([line("dumper_2", Condition.DEGRADED, "no triggers " * 20)]), width=80).splitlines()
    assert len(rows) == 2
    assert rows[1].startswith("dumper_2  degraded     60.0     3         0.4%  1000 us, 6.0 dB  no trig")


def test_a_low_terminal_shows_the_worst_and_counts_the_rest() -> None:
    client = FleetClient()
    for number in range(30):
        assert client.fleet.take(f"rig_{number}", status(f"rig_{number}"), 0.0)
    assert client.fleet.take("worst", status("worst", State.FAILED), 0.0)
    text = printed(panel_of_all(client, 10))
    assert len(text.splitlines()) == 10
    assert "worst" in text
    assert "26 more, none of them worse" in text


@pytest.mark.wire
def test_the_rigs_of_all_endpoints_are_printed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autoexpose_daemon.client.top._ROUND_S", 0.5)
    first, second, nowhere = endpoint(), endpoint(), endpoint()
    screen, console = screen_of(terminal=False)
    with daemon(status("scout", State.DEGRADED), first), daemon(status("mule"), second):
        show_all_once([first, second, nowhere], None, console, threading.Event())
    assert "2 rigs: 1 degraded, 1 exposing" in screen.text
    assert screen.text.index("no triggers") < screen.text.index("mule")
    assert f"no answer from {nowhere}" in screen.text


@pytest.mark.wire
def test_a_file_of_zenoh_has_the_endpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autoexpose_daemon.client.top._ROUND_S", 0.1)
    at = endpoint()
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"connect": {"endpoints": [at]}}))
    screen, console = screen_of(terminal=False)
    with daemon(status("scout"), at):
        show_all_once([], file, console, threading.Event())
        show_once("scout", [], console, file)
    assert "1 rig: 1 exposing" in screen.text
    assert "autoexpose scout, belief" in screen.text


@pytest.mark.wire
def test_messages_that_are_no_statuses_are_passed_over() -> None:
    at = endpoint()
    with open_session("peer", Endpoints(listen=[at])) as stranger, FleetClient([at]) as client:
        wait_until(lambda: not client.unanswered, "a connection")
        said = status("scout").to_json()

        def spoken() -> bool:
            for key, text in (("scout", ""), ("scout", "{}"), ("1st", said), ("mule", said), ("big", " " * (2 << 20))):
                stranger.put(rig_key(key, "status"), text)
            stranger.put("**", said)  # arrives under this key
            stranger.put(rig_key("scout", "status"), said)
            return client.heard.is_set()

        wait_until(spoken, "the one that is valid")
        assert set(conditions(client, 0.0)) == {"scout"}


@pytest.mark.wire
def test_a_router_may_allow_statuses_alone(tmp_path: Path) -> None:
    """As docs/do/fleets.md shows."""
    (rules,) = re.findall(r"```\w*\n(// from the router's file.*?)```", FLEETS.read_text(), re.DOTALL)
    far, near = endpoint(), endpoint()
    quiet = json.dumps({"mode": "router", "listen": {"endpoints": [far]}, "scouting": QUIET})
    file = tmp_path / "router.json5"
    file.write_text(f"{quiet[:-1]},\n{rules}}}")
    with (
        router(file),
        daemon(status("scout"), near, far),
        FleetClient([far]) as client,
        StatusClient("scout", [far]) as one,
    ):
        wait_until(client.heard.is_set, "a rig")
        assert one.wait(PATIENCE_S) is not None


@pytest.mark.wire
def test_a_router_that_goes_and_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is on the robot goes on meanwhile."""
    monkeypatch.setattr("autoexpose_daemon.client.top.FleetClient", lambda *args: FleetClient(*args, 1.0))
    far, near, other = endpoint(), endpoint(), endpoint()
    file = router_file(tmp_path, far)
    screen, console = screen_of()
    stop = threading.Event()
    thread = threading.Thread(target=follow_all, args=([far], None, console, stop))

    def shown(text: str) -> None:
        screen.seek(0)
        screen.truncate()
        wait_until(lambda: text in screen.text, text)

    with (
        daemon(status("scout"), near, far),
        daemon(status("mule", State.DEGRADED), other, far),
        StatusClient("scout", [near]) as on_board,
    ):
        thread.start()
        try:
            shown(f"no answer from {far}")
            with router(file):
                shown("2 rigs: 1 degraded, 1 exposing")
            shown("2 rigs: 2 silent")
            shown("degraded before: no triggers")
            assert on_board.wait(PATIENCE_S) is not None
            with router(file):
                shown("2 rigs: 1 degraded, 1 exposing")
        finally:
            stop.set()
            thread.join()
