"""What Prometheus reads, and what docs/look-up/metrics.md, the alerts and the dashboard that we ship make of it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import yaml
from prometheus_client.core import Metric
from prometheus_client.parser import text_string_to_metric_families

from autoexpose_daemon.client.status_client import TOO_MANY_LOST
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.messages.client import LAST_COUNT, ConsumerTally
from autoexpose_daemon.page.metrics import exposition
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.states import State
from autoexpose_daemon.status.telemetry import Telemetry
from tests import REPOSITORY
from tests.autoexpose_daemon.samples import EXPOSING, GROUPED

DOCS = REPOSITORY / "docs/look-up/metrics.md"
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
        ("autoexpose_flicker_hertz", ("all",)): 100,
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


def test_groups_and_cameras_have_figures_of_their_own() -> None:
    seen = samples(GROUPED)
    expected = {
        ("autoexpose_policy", ("front", "belief")): 1,
        ("autoexpose_policy", ("rear", "neves2009")): 1,
        ("autoexpose_image_metric", ("front",)): 0.11,
        ("autoexpose_image_metric", ("rear",)): 0.22,
        ("autoexpose_ev_stops", ("rear",)): -1,
        ("autoexpose_control_requests_total", ("front",)): 1,
        ("autoexpose_requested_exposure_time_seconds", ("front_right",)): 0.0022,
        ("autoexpose_requested_exposure_time_seconds", ("rear_left",)): 0.00031,
        ("autoexpose_applied_exposure_time_seconds", ("rear_right",)): 0.0003,
        ("autoexpose_frames_total", ("front_left",)): 900,
        ("autoexpose_lost_frames_total", ("rear_left",)): 100,
        ("autoexpose_lost_triggers_total", ("rear_left_missing",)): 90,
        ("autoexpose_lost_triggers_total", ("front_left_missing",)): 0,
    }
    assert {key: seen[key[0], frozenset(key[1])] for key in expected} == expected


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


EXAMPLES = REPOSITORY / "examples"
BOARD = json.loads((EXAMPLES / "grafana.json").read_text())
PANELS: list[dict[str, Any]] = BOARD["panels"]
TARGETS = [target for panel in PANELS for target in panel.get("targets", ())]
RULES = {rule["alert"]: rule for rule in yaml.safe_load((EXAMPLES / "alerts.yaml").read_text())["groups"][0]["rules"]}
CASES = yaml.safe_load((REPOSITORY / "tests" / "accept" / "prometheus" / "alerts.test.yaml").read_text())["tests"]

SAMPLES = [sample for family in families(EXPOSING) for sample in family.samples]
SERVED = {sample.name for sample in SAMPLES}
OF_PROMETHEUS = {"instance", "job"}
LABELS = {label for sample in SAMPLES for label in sample.labels} | OF_PROMETHEUS
VALUES = {(name, value) for sample in SAMPLES for name, value in sample.labels.items()}

EXPRESSIONS = [rule["expr"] for rule in RULES.values()] + [target["expr"] for target in TARGETS]


def selectors(expression: str) -> Iterator[tuple[str, str]]:
    """Each metric in an expression, and what stands in braces behind it."""
    yield from re.findall(r"\b(autoexpose_\w+)\b(?:\{([^}]*)\})?", expression)


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_metrics_and_labels_are_those_that_are_served(expression: str) -> None:
    for name, braces in selectors(expression):
        assert name in SERVED
        named = set(re.findall(r"(\w+)\s*(?:!~|=~|!=|=)", braces))
        assert named <= {label for sample in SAMPLES if sample.name == name for label in sample.labels}
        for label, values in re.findall(r'(\w+)\s*(?:!~|!=|=)\s*"([^"]*)"', braces):
            assert {(label, value) for value in values.split("|")} <= VALUES
    for labels in re.findall(r"\b(?:by|on) \(([^)]*)\)", expression):
        assert set(labels.split(", ")) <= LABELS


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target["expr"])
def test_a_panel_shows_the_rigs_that_were_chosen(target: dict[str, Any]) -> None:
    assert target["datasource"]["uid"] == "${datasource}"
    assert set(re.findall(r"{{(\w+)}}", target["legendFormat"])) <= LABELS
    assert 'rig=~"$rig"' in target["expr"] or target["expr"].startswith("count(ALERTS")


def test_panels_have_numbers_of_their_own_and_do_not_overlap() -> None:
    assert len({panel["id"] for panel in PANELS}) == len(PANELS)
    cells = [
        (column, line)
        for place in (panel["gridPos"] for panel in PANELS)
        for column in range(place["x"], place["x"] + place["w"])
        for line in range(place["y"], place["y"] + place["h"])
    ]
    assert len(set(cells)) == len(cells)
    assert max(column for column, _ in cells) < 24
    assert {variable["name"] for variable in BOARD["templating"]["list"]} == {"datasource", "rig"}


@pytest.mark.parametrize("alert", RULES)
def test_a_case_shows_the_alert_fire_and_cases_show_it_silent(alert: str) -> None:
    tried = [entry for case in CASES for entry in case["alert_rule_test"] if entry["alertname"] == alert]
    assert {bool(entry["exp_alerts"]) for entry in tried} == {True, False}
    assert any(case["name"] == "all is well" and entry in case["alert_rule_test"] for case in CASES for entry in tried)


@pytest.mark.parametrize("alert", RULES)
def test_the_page_names_it(alert: str) -> None:
    assert f"| `{alert}` |" in (REPOSITORY / "docs/look-up/metrics.md").read_text()


def test_the_terminal_and_the_alert_agree_on_how_many_losses_are_too_many() -> None:
    assert f"> {TOO_MANY_LOST} * sum by (rig, instance)" in RULES["AutoexposeLosesTriggers"]["expr"]
