"""Some minutes of `make soak`: every kind of fault once, and the books balance."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from tests.soak import faults
from tests.soak.clock import SECOND
from tests.soak.day import Day, LogCounter, Minute


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> Iterator[LogCounter]:
    """Counts lines of the log, in short minutes: a fault begins within 15 s, lasts up to 14, and is over 6 s later."""
    monkeypatch.setattr("tests.soak.day.MINUTE_NS", 36 * SECOND)
    counter = LogCounter()
    logging.getLogger().addHandler(counter)
    yield counter
    logging.getLogger().removeHandler(counter)


def wrong(minutes: list[Minute]) -> dict[str, list[str]]:
    return {minute.fault: minute.wrong for minute in minutes if minute.wrong}


def test_every_fault_shows_where_it_should_and_nowhere_else(log: LogCounter) -> None:
    day = Day(20261121, log)
    minutes = list(day.minutes(len(faults.FAULTS)))
    assert len({minute.fault for minute in minutes}) == len(faults.FAULTS)
    assert wrong(minutes) == {}
    assert day.close() is None


def test_six_cameras_in_three_groups_lose_what_the_wire_says_and_no_other_camera_does(
    log: LogCounter, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = (faults.camera_lost, faults.cameras_lost, faults.frames_of_several_lost, faults.writes_slow)
    monkeypatch.setattr("tests.soak.day.FAULTS", chosen)
    day = Day(20261128, log, cameras=6)
    minutes = list(day.minutes(len(chosen)))
    assert [len(group.cameras) for group in day.rig.control.groups.values()] == [2, 2, 2]
    assert {minute.fault for minute in minutes} == {fault.__name__ for fault in chosen}
    assert wrong(minutes) == {}
    assert day.close() is None
    levels = [group.asked.level for group in day.rig.control.groups.values() if group.asked is not None]
    assert len(levels) == 3 and len(set(levels)) > 1  # each group goes its own way
