from __future__ import annotations

import json
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.messages.client import LARGEST_REPORT_BYTES, LAST_COUNT, ConsumerTally
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.panel import line_of
from autoexpose_daemon.status.states import Expectation, State, judge
from autoexpose_daemon.status.telemetry import (
    GONE_NS,
    MOST_KNOWN,
    MOST_LISTED,
    CameraTally,
    Consumers,
    DropReason,
    PublishTally,
    Telemetry,
)

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}}})
COUNT = st.integers(0, LAST_COUNT)
JSON = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists)


@given(st.builds(ConsumerTally, COUNT, COUNT, COUNT, COUNT, COUNT))
def test_a_report_arrives_as_it_was_sent(tally: ConsumerTally) -> None:
    assert ConsumerTally.from_json(tally.to_json()) == tally


@given(st.one_of(st.binary(), st.dictionaries(st.text(), JSON).map(str), st.just("[" * 100_000)))
def test_what_is_no_report_is_nothing(text: str | bytes) -> None:
    assert ConsumerTally.from_json(text) is None


@pytest.mark.parametrize("count", [-1, LAST_COUNT + 1, 10**400, 1.5, True, "1", None, [1]])
def test_a_count_that_is_none_makes_no_report(count: object) -> None:
    report = json.loads(ConsumerTally().to_json())
    assert ConsumerTally.from_json(json.dumps(report | {"pairs": 1})) == ConsumerTally(pairs=1)
    assert ConsumerTally.from_json(json.dumps(report | {"pairs": count})) is None


def test_a_long_report_is_not_even_read() -> None:
    report = ConsumerTally().to_json()
    assert ConsumerTally.from_json(report.ljust(LARGEST_REPORT_BYTES)) is not None
    assert ConsumerTally.from_json(report.ljust(LARGEST_REPORT_BYTES + 1)) is None


def test_a_consumer_that_falls_silent_is_forgotten() -> None:
    consumers = Consumers()
    consumers.heard("slam", ConsumerTally(pairs=5), 0)
    assert dict(consumers.listed(GONE_NS - 1)) == {"slam": ConsumerTally(pairs=5)}
    assert not consumers.listed(GONE_NS)


def test_those_that_take_pairs_are_listed_before_names_that_somebody_made_up() -> None:
    consumers = Consumers()
    for number in range(MOST_LISTED):
        consumers.heard(f"invented{number}", ConsumerTally(pairs=7), number)
    for pairs in range(2):
        consumers.heard("slam", ConsumerTally(pairs=pairs), 100)
    listed = list(consumers.listed(100))
    assert listed == ["slam", *(f"invented{number}" for number in range(MOST_LISTED - 1))]
    assert consumers.unlisted(100) == 1


def test_made_up_names_are_not_remembered_without_bound_and_drive_nobody_out() -> None:
    consumers = Consumers()
    for pairs in range(2):
        consumers.heard("slam", ConsumerTally(pairs=pairs), 0)
    for number in range(3 * MOST_KNOWN):
        consumers.heard(f"invented{number}", ConsumerTally(), 1)
    assert "slam" in consumers.listed(1)
    assert consumers.unlisted(1) == MOST_KNOWN - MOST_LISTED
    for pairs in range(2):
        consumers.heard("late", ConsumerTally(pairs=pairs), 2)
    assert list(consumers.listed(2))[:2] == ["slam", "late"]
    assert not consumers.unlisted(GONE_NS + 2)


def test_a_consumer_is_announced_when_it_takes_its_first_pairs_and_not_among_a_crowd() -> None:
    consumers = Consumers()
    announced = [consumers.heard("slam", ConsumerTally(pairs=pairs), 0) for pairs in (0, 0, 3, 6)]
    assert announced == [False, False, True, False]
    for number in range(MOST_LISTED):
        consumers.heard(f"invented{number}", ConsumerTally(), 0)
    assert not consumers.heard("invented0", ConsumerTally(pairs=1), 0)


def test_the_operator_reads_it_all_in_one_line() -> None:
    tally = PublishTally(sent=100, trouble="no such endpoint")
    tally.dropped[DropReason.BEHIND] = 2
    tally.consumers.heard("slam", ConsumerTally(pairs=90, missed=3, lost=2, too_slow=1), time.monotonic_ns())
    for number in range(MOST_LISTED):
        tally.consumers.heard(f"c{number}", ConsumerTally(), time.monotonic_ns())
    line = line_of(describe(Telemetry(publishing=tally), CONFIG))
    assert "published 100, dropped: 2 behind" in line
    assert "not published no such endpoint" in line
    assert "consumer slam 90 pairs, 3 missed, 2 lost, 1 too slow" in line
    assert "consumers 1 more, not listed" in line


def test_frames_that_cannot_be_published_degrade_the_daemon() -> None:
    now_ns = 10**12
    telemetry = Telemetry(cameras=CameraTally({"left": "L"}, {"left": now_ns}), last_pair_ns=now_ns)
    expected = Expectation(("left",), 1 / 60, True, 0)
    telemetry.publishing = PublishTally()
    assert judge(telemetry, expected, now_ns).state is State.EXPOSING
    telemetry.publishing.trouble = "no such endpoint"
    health = judge(telemetry, expected, now_ns)
    assert (health.state, health.reasons) == (State.DEGRADED, ("frames are not published: no such endpoint",))
