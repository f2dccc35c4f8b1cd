"""The status of a daemon: how it is built, sent and read."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable, Iterator
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.messages.client import (
    LARGEST_REPORT_BYTES,
    LARGEST_RESPONSE_BYTES,
    LAST_COUNT,
    ConsumerTally,
    response_from_json,
    response_to_json,
    vignetting_from_json,
)
from autoexpose_daemon.status.counters import Counts
from autoexpose_daemon.status.describe import KEPT_FAULTS, LONGEST_TEXT, FaultLog, describe
from autoexpose_daemon.status.document import (
    LARGEST_STATUS_BYTES,
    VERSION,
    DurationStatus,
    Fault,
    PublishStatus,
    RecorderStatus,
    Status,
)
from autoexpose_daemon.status.panel import duration_text
from autoexpose_daemon.status.states import State
from autoexpose_daemon.status.telemetry import MOST_LISTED, Telemetry
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction
from imaging.vignetting import MOST_NODES, Vignetting
from tests.autoexpose_daemon.samples import EXPOSING

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})
JSON = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists)
COUNT = st.integers(0, LAST_COUNT)


def test_a_status_arrives_as_it_was_sent() -> None:
    assert Status.from_json(EXPOSING.to_json()) == EXPOSING
    assert Status.from_json(describe(Telemetry(), CONFIG).to_json()) is not None


def test_fields_of_later_versions_are_left_alone() -> None:
    later = json.loads(EXPOSING.to_json()) | {"tomorrow": {"new": 1}}
    later["cameras"]["left"]["new"] = [2]
    assert Status.from_json(json.dumps(later)) == EXPOSING


@given(st.one_of(st.binary(), JSON.map(json.dumps), st.dictionaries(st.text(), JSON).map(json.dumps)))
@example("[" * 100_000)
def test_what_is_no_status_is_nothing(text: str | bytes) -> None:
    assert Status.from_json(text) is None
    assert response_from_json(text) is None and vignetting_from_json(text) is None
    assert ConsumerTally.from_json(text) is None


@given(st.sampled_from(sorted(json.loads(EXPOSING.to_json()))), JSON)
def test_a_damaged_field_does_no_harm(field: str, value: object) -> None:
    damaged = json.loads(EXPOSING.to_json()) | {field: value}
    status = Status.from_json(json.dumps(damaged))
    assert status is None or Status.from_json(status.to_json()) is not None


def fields_of(kind: type) -> Iterator[tuple[type, str]]:
    """Counts and other numbers of a status, and of what it is made of."""
    return ((kind, field.name) for field in fields(kind) if re.match("Count|_Seconds|_Milliseconds|_Hertz", field.type))


BOUNDED = [pair for kind in (Status, Counts, DurationStatus, PublishStatus, RecorderStatus) for pair in fields_of(kind)]


@pytest.mark.parametrize("value", [-(10**20), 10**400, "1e999", "NaN"])
@pytest.mark.parametrize(("kind", "field"), BOUNDED)
def test_a_number_without_bounds_is_no_status(kind: type, field: str, value: object) -> None:
    """Such numbers would fail where they are shown, far from the door they came in by."""
    said = json.loads(EXPOSING.to_json())
    parts = {Counts: "counts", DurationStatus: "write_ms", PublishStatus: "publishing", RecorderStatus: "recorder"}
    (said[parts[kind]] if kind in parts else said)[field] = value
    assert Status.from_json(json.dumps(said)) is None


@pytest.mark.parametrize(
    ("text", "read", "most_bytes"),
    [
        (EXPOSING.to_json(), Status.from_json, LARGEST_STATUS_BYTES),
        (response_to_json(ResponseFunction.linear()), response_from_json, LARGEST_RESPONSE_BYTES),
        (ConsumerTally().to_json(), ConsumerTally.from_json, LARGEST_REPORT_BYTES),
    ],
    ids=["status", "response", "report"],
)
def test_what_is_longer_than_any_daemon_says_is_not_even_read(
    text: str, read: Callable[[str], object], most_bytes: int
) -> None:
    assert read(text.ljust(most_bytes)) is not None
    assert read(text.ljust(most_bytes + 1)) is None


def test_the_longest_status_that_a_daemon_can_say_is_read() -> None:
    fault = Fault(2e9, "WARNING", LONGEST_TEXT * "\U0001f4f7")
    consumers = {f"{number:064}": ConsumerTally(*[LAST_COUNT] * 5) for number in range(MOST_LISTED)}
    publishing = PublishStatus(1, 1, {}, "no such endpoint", consumers, 1000)
    status = replace(EXPOSING, faults=(fault,) * KEPT_FAULTS, publishing=publishing)
    assert Status.from_json(status.to_json()) == status


def test_daemons_of_before_and_newer_ones_are_read() -> None:
    said = json.loads(EXPOSING.to_json()) | {"news": 1}
    said["counts"]["flashes"] = 3
    del said["publishing"]["unlisted_consumers"], said["counts"]["late_writes"]
    expected = replace(EXPOSING, counts=replace(EXPOSING.counts, late_writes=0))
    assert Status.from_json(json.dumps(said)) == expected


def test_losses_for_a_thousand_reasons_are_no_status() -> None:
    rows = {f"reason{number}": 1 for number in range(1000)}
    assert Status.from_json(json.dumps(json.loads(EXPOSING.to_json()) | {"lost": rows})) is None


def test_other_versions_and_impossible_exposures_are_refused() -> None:
    assert Status.from_json(replace(EXPOSING, version=VERSION + 1).to_json()) is None
    for setting in (ExposureSetting(0.0, 0.0), ExposureSetting(1e300, 0.0), ExposureSetting(100.0, -1e9)):
        left = replace(EXPOSING.cameras["left"], applied=setting)
        assert Status.from_json(replace(EXPOSING, cameras={"left": left}).to_json()) is None


def test_a_number_that_is_none_hides_nothing_else() -> None:
    assert EXPOSING.decision is not None
    odd = replace(EXPOSING, decision=replace(EXPOSING.decision, metric=float("nan")))
    status = Status.from_json(odd.to_json())
    assert status is not None
    assert status.decision is not None
    assert np.isnan(status.decision.metric)


def test_a_response_arrives_as_it_was_sent_with_its_vignetting() -> None:
    response = ResponseFunction.linear(16)
    for lens in (
        None,
        Vignetting(96, 72, (47.5, 30.25), (-0.5, 0.125)),
        Vignetting(96, 72, (47.5, 35.5), (), ((1.0, 0.5), (0.5, 0.25))),
    ):
        text = response_to_json(response, lens)
        received = response_from_json(text)
        assert received is not None and np.array_equal(received.log2_exposure, response.log2_exposure)
        assert (received.black_level, received.saturation) == (16, 255)
        assert vignetting_from_json(text) == lens


def test_the_largest_grid_of_a_vignetting_arrives() -> None:
    light = np.random.default_rng(1).uniform(3e-5, 9e-5, (MOST_NODES, MOST_NODES))
    lens = Vignetting(1440, 1080, (719.5, 539.5), (), tuple(tuple(row) for row in light.tolist()))
    text = response_to_json(ResponseFunction.linear(16), lens)
    received = vignetting_from_json(text)
    assert response_from_json(text) is not None and received is not None
    assert np.allclose(received.grid, light, rtol=1e-5, atol=0)


@pytest.mark.parametrize(
    "lens", [{"coefficients": [-0.1] * 9}, {"coefficients": [True]}, {"width": 96.0}, {"grid": [1]}]
)
def test_a_vignetting_that_no_lens_has_is_none(lens: dict[str, object]) -> None:
    said = json.loads(response_to_json(ResponseFunction.linear(), Vignetting(96, 72, (47.5, 35.5), (-0.5,))))
    said["vignetting"] |= lens
    assert vignetting_from_json(json.dumps(said)) is None


def test_a_daemon_that_died_says_of_what() -> None:
    telemetry = Telemetry(opened_ns=0, last_pair_ns=0)
    telemetry.failed(ZeroDivisionError())
    status = describe(telemetry, CONFIG, ending=True)
    assert (status.state, status.reasons, status.ending) == (State.FAILED, ("ZeroDivisionError",), True)


def test_the_fault_log_keeps_the_latest_faults_a_line_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logging, "raiseExceptions", False)
    log, faults = logging.Logger("test"), FaultLog()
    log.addHandler(faults)
    log.info("all is well")
    for number in range(2 * KEPT_FAULTS):
        log.warning("fault %d\nof two lines", number)
    log.error("state failed")
    log.error("no number: %d", "none")  # a broken message must not stop what logs it
    kept = faults.faults
    assert len(kept) == KEPT_FAULTS
    assert kept[-2].message == f"fault {2 * KEPT_FAULTS - 1} of two lines"
    assert (kept[-1].level, kept[-1].message) == ("ERROR", "state failed")


@pytest.mark.parametrize(
    ("seconds", "text"), [(1.2, "1 s"), (119, "119 s"), (120, "2 min"), (3600, "1 h 0 min"), (49 * 3600, "2 d 1 h")]
)
def test_durations_have_a_unit_that_suits_their_length(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


@given(st.builds(ConsumerTally, COUNT, COUNT, COUNT, COUNT, COUNT))
def test_a_report_arrives_as_it_was_sent(tally: ConsumerTally) -> None:
    assert ConsumerTally.from_json(tally.to_json()) == tally


@pytest.mark.parametrize("count", [-1, LAST_COUNT + 1, 10**400, 1.5, True, "1", None, [1]])
def test_a_count_that_is_none_makes_no_report(count: object) -> None:
    report = json.loads(ConsumerTally().to_json())
    assert ConsumerTally.from_json(json.dumps(report | {"pairs": 1})) == ConsumerTally(pairs=1)
    assert ConsumerTally.from_json(json.dumps(report | {"pairs": count})) is None
