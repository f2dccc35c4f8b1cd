"""Some minutes of `make soak`: every kind of fault once, and the books balance."""

from __future__ import annotations

import logging

import pytest

from tests.soak.clock import SECOND
from tests.soak.day import Day, LogCounter
from tests.soak.faults import FAULTS


@pytest.fixture
def log() -> LogCounter:
    return LogCounter()


def test_every_fault_shows_where_it_should_and_nowhere_else(log: LogCounter, monkeypatch: pytest.MonkeyPatch) -> None:
    """In short minutes: a fault begins within 15 seconds, lasts up to 14, and is over 6 seconds later."""
    monkeypatch.setattr("tests.soak.day.MINUTE_NS", 36 * SECOND)
    root = logging.getLogger()
    root.addHandler(log)
    try:
        day = Day(20261121, log)
        minutes = list(day.minutes(len(FAULTS)))
    finally:
        root.removeHandler(log)
    assert len({minute.fault for minute in minutes}) == len(FAULTS)
    assert {minute.fault: minute.wrong for minute in minutes if minute.wrong} == {}
    assert day.close() is None
