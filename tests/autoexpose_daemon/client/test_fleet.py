"""Which rig is worse than which, by statuses made up and a clock that is set."""

from __future__ import annotations

from dataclasses import replace

import pytest

from autoexpose_daemon.client.status_client import MOST_RIGS, Condition, Fleet, RigLine
from autoexpose_daemon.status.counters import Counts
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.states import State
from tests.autoexpose_daemon.statuses import EXPOSING

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


def test_many_statuses_within_a_second_take_the_room_of_one() -> None:
    fleet = fleet_of(status("scout", pairs=0))
    for number in range(1, 2001):
        fleet.take("scout", status("scout", pairs=number, missing=number), number / 1000)
    assert len(fleet._rigs["scout"].counts) <= 4
    assert only(fleet, 2.0).lost_share == pytest.approx(0.5)


@pytest.mark.parametrize("rig", ["", "1st", "a b", "\x1b[2J", "*", "x" * 101])
def test_a_key_that_names_no_rig_is_passed_over(rig: str) -> None:
    fleet = Fleet(SILENT_S)
    assert not fleet.take(rig, replace(EXPOSING, rig=rig), 0.0)
    assert not fleet.lines(0.0)


def test_a_status_under_the_key_of_another_rig_is_passed_over() -> None:
    fleet = fleet_of(status("scout"))
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


def test_long_reasons_of_strangers_are_cut() -> None:
    said = replace(status("scout", State.DEGRADED), reasons=("x" * 100_000,), lost={"y" * 100_000: 1})
    known = fleet_of(said)._rigs["scout"]
    assert max(len(known.reasons), len(known.lost_words)) <= 300
