from __future__ import annotations

import time

from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.config import Config
from autoexpose_daemon.describe import describe
from autoexpose_daemon.panel import line_of
from autoexpose_daemon.publish.tally import GONE_NS, MOST_CONSUMERS, ConsumerTally, DropReason, PublishTally
from autoexpose_daemon.states import Expectation, State, judge
from autoexpose_daemon.telemetry import Telemetry

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}}})
COUNT = st.integers(0, 2**60)
JSON = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists)


@given(st.builds(ConsumerTally, COUNT, COUNT, COUNT, COUNT, COUNT))
def test_a_report_arrives_as_it_was_sent(tally: ConsumerTally) -> None:
    assert ConsumerTally.from_json(tally.to_json()) == tally


@given(st.one_of(st.binary(), st.dictionaries(st.text(), JSON).map(str), st.just("[" * 100_000)))
def test_what_is_no_report_is_nothing(text: str | bytes) -> None:
    assert ConsumerTally.from_json(text) is None


def test_a_consumer_that_says_nothing_any_more_is_forgotten() -> None:
    tally = PublishTally()
    tally.heard("slam", ConsumerTally(pairs=5), 0)
    assert dict(tally.consumers(GONE_NS - 1)) == {"slam": ConsumerTally(pairs=5)}
    assert not tally.consumers(GONE_NS)


def test_consumers_are_not_remembered_without_bound() -> None:
    tally = PublishTally()
    new = [tally.heard(f"c{number}", ConsumerTally(), 0) for number in range(2 * MOST_CONSUMERS)]
    assert sum(new) == MOST_CONSUMERS
    assert len(tally.consumers(0)) == MOST_CONSUMERS
    tally.heard("c0", ConsumerTally(pairs=1), 1)
    assert tally.consumers(1)["c0"].pairs == 1
    tally.heard("late", ConsumerTally(), GONE_NS + 1)
    assert set(tally.consumers(GONE_NS + 1)) == {"late"}


def test_the_operator_reads_it_all_in_one_line() -> None:
    tally = PublishTally(sent=100, trouble="no such endpoint")
    tally.dropped[DropReason.BEHIND] = 2
    tally.heard("slam", ConsumerTally(pairs=90, missed=3, lost=2, too_slow=1), time.monotonic_ns())
    line = line_of(describe(Telemetry(publishing=tally), CONFIG))
    assert "published 100, dropped: 2 behind" in line
    assert "not published no such endpoint" in line
    assert "consumer slam 90 pairs, 3 missed, 2 lost, 1 too slow" in line


def test_frames_that_cannot_be_published_degrade_the_daemon() -> None:
    now_ns = 10**12
    telemetry = Telemetry(cameras={"left": "L"}, last_frame_ns={"left": now_ns}, last_pair_ns=now_ns)
    expected = Expectation(("left",), 1 / 60, True, 0)
    telemetry.publishing = PublishTally()
    assert judge(telemetry, expected, now_ns).state is State.EXPOSING
    telemetry.publishing.trouble = "no such endpoint"
    health = judge(telemetry, expected, now_ns)
    assert (health.state, health.reasons) == (State.DEGRADED, ("frames are not published: no such endpoint",))
