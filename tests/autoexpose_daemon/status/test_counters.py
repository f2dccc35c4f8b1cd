"""One declared table of counters: whatever shows them follows it."""

from __future__ import annotations

import io
import json
import re
from dataclasses import field, make_dataclass, replace

import pytest
from rich.console import Console

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.page.app import tables
from autoexpose_daemon.page.metrics import exposition
from autoexpose_daemon.status.counters import Counts, counters
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import line_of, table_of
from autoexpose_daemon.status.telemetry import Telemetry
from tests import REPOSITORY
from tests.autoexpose_daemon.statuses import EXPOSING

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}}})
FLASHES = {"topic": "triggers", "label": "flashes of lightning", "meaning": "Flashes of lightning."}


def text_of(status: Status) -> str:
    screen = io.StringIO()
    Console(file=screen, width=120).print(table_of(status))
    return screen.getvalue()


@pytest.mark.parametrize("unusual", [True, False])
def test_a_new_line_of_the_table_shows_wherever_counters_do(unusual: bool) -> None:
    entry = field(default=0, metadata=FLASHES | {"unusual": unusual})
    more = make_dataclass("More", [("flashes", int, entry)], bases=(Counts,), slots=True)
    telemetry = Telemetry(counts=more())
    telemetry.counts.flashes += 3  # type: ignore[attr-defined]

    status = describe(telemetry, CONFIG)
    assert json.loads(status.to_json())["counts"]["flashes"] == 3
    assert ("flashes of lightning", 3, unusual) in tables(status)["triggers"]
    metrics = exposition("rig", status).decode()
    assert "# HELP autoexpose_flashes_total Flashes of lightning.\n" in metrics
    assert 'autoexpose_flashes_total{rig="rig"} 3.0\n' in metrics
    assert ("flashes of lightning: 3" in line_of(status)) == unusual
    assert bool(re.search(r"flashes of lightning +3", text_of(status))) == unusual


def test_every_counter_has_a_row_in_the_docs_in_its_own_words() -> None:
    docs = (REPOSITORY / "docs" / "metrics.md").read_text()
    for counter, _ in counters(Counts()):
        meaning = counter.meaning[0].lower() + counter.meaning[1:].rstrip(".")
        assert f"| `autoexpose_{counter.name}_total` | counter | | {meaning} |\n" in docs


def test_a_status_goes_on_counting_for_nobody() -> None:
    telemetry = Telemetry()
    status = describe(telemetry, CONFIG)
    telemetry.counts.pairs += 1
    assert status.counts.pairs == 0


def test_counters_of_another_version_are_passed_over_and_missing_ones_are_0() -> None:
    said = json.loads(EXPOSING.to_json())
    del said["counts"]["late_writes"]
    said["counts"]["flashes"] = 3
    counts = replace(EXPOSING.counts, late_writes=0)
    assert Status.from_json(json.dumps(said)) == replace(EXPOSING, counts=counts)
