"""What Prometheus reads, and what docs/metrics.md promises."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from prometheus_client.core import Metric
from prometheus_client.parser import text_string_to_metric_families

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.messages.client import LAST_COUNT, ConsumerTally
from autoexpose_daemon.page.metrics import exposition
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.states import State
from autoexpose_daemon.status.telemetry import Telemetry
from tests import REPOSITORY
from tests.autoexpose_daemon.statuses import EXPOSING

DOCS = REPOSITORY / "docs" / "metrics.md"
ROW = re.compile(r"^\| `(autoexpose_\w+)` \| (\w+) \|([^|]*)\|", re.MULTILINE)


def families(status: Status | None) -> list[Metric]:
    return list(text_string_to_metric_families(exposition("rig", status).decode()))


def samples(status: Status | None) -> dict[tuple[str, frozenset[str]], float]:
    """By name and the values of the labels but `rig`."""
    found = {}
    for family in families(status):
        for sample in family.samples:
            labels = dict(sample.labels)
            assert labels.pop("rig") == "rig"
            found[sample.name, frozenset(labels.values())] = sample.value
    return found


def full_name(family: Metric) -> str:
    return f"{family.name}_total" if family.type == "counter" else family.name


def labels_of(family: Metric) -> set[str]:
    return {label for sample in family.samples for label in sample.labels} - {"rig"}


def test_the_table_in_the_docs_names_what_is_served() -> None:
    documented = {
        name: (kind, set(re.findall(r"`(\w+)`", labels))) for name, kind, labels in ROW.findall(DOCS.read_text())
    }
    served = {full_name(family): (family.type, labels_of(family)) for family in families(EXPOSING)}
    assert documented == served


def test_numbers_arrive_in_base_units() -> None:
    seen = samples(EXPOSING)
    expected = {
        ("autoexpose_up", ()): 1,
        ("autoexpose_state", ("exposing",)): 1,
        ("autoexpose_state", ("degraded",)): 0,
        ("autoexpose_requested_exposure_time_seconds", ("right",)): 0.0011,
        ("autoexpose_applied_exposure_time_seconds", ("left",)): 0.001,
        ("autoexpose_applied_gain_decibels", ("left",)): 6,
        ("autoexpose_response_drift_grey_levels", ("left",)): 0.5,
        ("autoexpose_flicker_hertz", ()): 100,
        ("autoexpose_pairs_total", ()): 432_000,
        ("autoexpose_lost_triggers_total", ("left_missing",)): 3,
        ("autoexpose_lost_triggers_total", ("stale",)): 0,
        ("autoexpose_decisions_at_brightest_limit_total", ()): 8,
        ("autoexpose_decision_seconds", ("0.99",)): 0.008,
        ("autoexpose_decision_seconds_count", ()): 100,
        ("autoexpose_decision_seconds_sum", ()): 0.25,
        ("autoexpose_unpublished_pairs_total", ("behind",)): 10,
        ("autoexpose_consumer_lost_pairs_total", ("slam", "too_slow")): 4,
        ("autoexpose_recorder_dropped_steps_total", ()): 11,
        ("autoexpose_steered", ()): 1,
        ("autoexpose_tracking_reports_total", ()): 20,
        ("autoexpose_refused_tracking_reports_total", ("stale",)): 22,
        ("autoexpose_refused_tracking_reports_total", ("future",)): 0,
    }
    assert {key: seen[key[0], frozenset(key[1])] for key in expected} == expected
    assert ("autoexpose_response_drift_grey_levels", frozenset({"right"})) not in seen


def test_consumers_that_are_not_listed_are_counted_and_the_highest_count_is_served() -> None:
    assert EXPOSING.publishing is not None
    crowd = replace(EXPOSING.publishing, consumers={"slam": ConsumerTally(*[LAST_COUNT] * 5)}, unlisted_consumers=7)
    seen = samples(replace(EXPOSING, publishing=crowd))
    assert seen["autoexpose_consumers", frozenset()] == 8
    assert seen["autoexpose_consumer_pairs_total", frozenset({"slam"})] == float(LAST_COUNT)


@pytest.mark.parametrize("status", [None, replace(EXPOSING, ending=True, state=State.FAILED)])
def test_a_daemon_that_is_gone_is_down(status: Status | None) -> None:
    assert samples(status)["autoexpose_up", frozenset()] == 0


def test_nothing_but_that_is_told_of_a_silent_daemon() -> None:
    assert [family.name for family in families(None)] == ["autoexpose_up"]


def test_a_daemon_without_a_frame_yet_can_be_read() -> None:
    config = Config.model_validate({"cameras": {"left": {"serial": "L"}}})
    seen = samples(describe(Telemetry(), config))
    assert seen["autoexpose_camera_up", frozenset({"left"})] == 0
    assert seen["autoexpose_decision_seconds_count", frozenset()] == 0
    assert "autoexpose_published_pairs_total" not in {name for name, _ in seen}
