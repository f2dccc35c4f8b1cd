"""The alerts and the dashboard that we ship: they name what is served. `make accept` has Prometheus evaluate both."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from autoexpose_daemon.client.status_client import TOO_MANY_LOST
from tests import REPOSITORY
from tests.autoexpose_daemon.page.test_metrics import families
from tests.autoexpose_daemon.statuses import EXPOSING

EXAMPLES = REPOSITORY / "docs" / "examples"
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
    assert f"| `{alert}` |" in (REPOSITORY / "docs" / "metrics.md").read_text()


def test_the_terminal_and_the_alert_agree_on_how_many_losses_are_too_many() -> None:
    assert f"> {TOO_MANY_LOST} * sum by (rig, instance)" in RULES["AutoexposeLosesTriggers"]["expr"]
