"""What is counted and timed: one table of counters, and what is the daemon's latency."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterable
from dataclasses import field, fields, make_dataclass

import numpy as np
import pytest
from rich.console import Console

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.page.app import tables
from autoexpose_daemon.page.metrics import exposition
from autoexpose_daemon.status.counters import DURATIONS, Counts, counters
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import (
    DurationStatus,
    Status,
)
from autoexpose_daemon.status.panel import line_of, table_of
from autoexpose_daemon.status.telemetry import DurationSamples, Telemetry
from drivers.rig.events import Written
from drivers.triggers import RigRecord
from drivers.triggers.writes import Command
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from tests import REPOSITORY
from tests.soak import camera
from tests.soak.clock import MS, SECOND
from tests.soak.rig import PERIOD_NS, VirtualRig
from tests.soak.wire import Wire

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
    docs = (REPOSITORY / "docs/look-up/metrics.md").read_text()
    for counter, _ in counters(Counts()):
        meaning = counter.meaning[0].lower() + counter.meaning[1:].rstrip(".")
        assert f"| `autoexpose_{counter.name}_total` | counter | | {meaning} |\n" in docs


def test_a_status_goes_on_counting_for_nobody() -> None:
    telemetry = Telemetry()
    status = describe(telemetry, CONFIG)
    telemetry.counts.pairs += 1
    assert status.counts.pairs == 0


def test_a_write_is_timed_from_its_own_frame() -> None:
    telemetry, setting = Telemetry(), ExposureSetting(1000.0, 0.0)
    write = Written("left", setting, setting, 17 * MS, 34 * MS)
    telemetry.written(write, Command(1, setting, arrival_ns=10 * MS, decided_ns=15 * MS, due_ns=15 * MS))
    assert (telemetry.held_ms.sum_ms, telemetry.write_ms.sum_ms, telemetry.frame_to_node_ms.sum_ms) == (2.0, 17.0, 24.0)
    telemetry.written(write, None)  # no decision caused it
    assert telemetry.frame_to_node_ms.count == telemetry.write_ms.count == telemetry.held_ms.count == 1


def test_a_camera_that_returns_is_not_a_slow_write() -> None:
    rig = VirtualRig(1, lambda _step: None, lambda _now_ns, _health: None)
    wire = Wire(rig, 2 * SECOND)
    left, right = rig.devices
    for seconds in (5, 13):
        rig.run(wire.actors, seconds * SECOND)
        left.vanish()
        rig.run(wire.actors, (seconds + 2) * SECOND)
        right.vanish()  # from now on nothing is decided
        rig.run(wire.actors, (seconds + 5) * SECOND)
        left.present = right.present = True
    rig.run(wire.actors, 21 * SECOND)
    telemetry = rig.control.telemetry
    assert telemetry.counts.reconnects == 4
    assert telemetry.frame_to_node_ms.count > 50
    assert telemetry.frame_to_node_ms.latest_ms.max() < 2 * PERIOD_NS / MS


def test_the_parts_make_up_the_whole() -> None:
    rig = VirtualRig(2, lambda _step: None, lambda _now_ns, _health: None)
    rig.run(Wire(rig, 2 * SECOND).actors, 20 * SECOND)
    telemetry = rig.control.telemetry
    steps, writes = telemetry.decision_ms, telemetry.frame_to_node_ms
    assert telemetry.pairing_ms.count == steps.count > writes.count / 2 == telemetry.held_ms.count / 2
    before_ms = (telemetry.pairing_ms.sum_ms + steps.sum_ms) / steps.count
    after_ms = (telemetry.held_ms.sum_ms + telemetry.write_ms.sum_ms) / writes.count
    assert np.isclose(writes.sum_ms / writes.count, before_ms + after_ms, rtol=0.1)


def test_quick_writes_shorten_how_long_decisions_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """A readout so slow that many decisions are ready within 5 ms of the next exposure."""
    monkeypatch.setattr(camera, "READOUT_NS", 8 * MS)
    rig = VirtualRig(3, lambda _step: None, lambda _now_ns, _health: None)
    for device in rig.devices:
        device.write_ns = MS // 2
    rig.run(Wire(rig, 2 * SECOND).actors, 400 * SECOND)
    held = rig.control.telemetry.held_ms.latest_ms > 0.1
    assert held[:500].mean() > 0.5
    assert held[-500:].mean() < 0.1


def test_every_duration_is_declared_and_kept() -> None:
    declared = [duration.field for duration in DURATIONS]
    assert [name for name in declared if isinstance(getattr(Telemetry(), name), DurationSamples)] == declared
    kept = [name for name in Telemetry.__slots__ if isinstance(getattr(Telemetry(), name), DurationSamples)]
    assert kept == declared
    assert [field.name for field in fields(Status) if field.type == DurationStatus.__name__] == declared


LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)


def test_decisions_at_a_bound_are_counted() -> None:
    telemetry = Telemetry()
    for level in (LIMITS.darkest.level, 12.0, LIMITS.brightest.level, LIMITS.brightest.level):
        telemetry.decided(Decision(LIMITS.realise(level, 1000.0), level, "", 0.1, 0.0, 0.0, 0.0), LIMITS)
    counts = telemetry.counts
    assert (counts.decisions_at_darkest_limit, counts.decisions_at_brightest_limit) == (1, 2)


@pytest.mark.parametrize(("rate_hz", "triggers"), [(1.0, range(3)), (60.0, (*range(100), *range(9000, 9010)))])
def test_the_rate_holds_between_slow_triggers_and_after_a_pause(rate_hz: float, triggers: Iterable[int]) -> None:
    telemetry, record = Telemetry(period_s=1 / rate_hz), RigRecord(["left"], {}, rate_hz, 0)
    for number in triggers:
        start_ns = round(number * 1e9 / rate_hz)
        frame = Frame(np.zeros((2, 2), np.uint8), 8, number, start_ns, start_ns, start_ns, ExposureSetting(1e3, 0.0))
        telemetry.delivered(FrameSet(number, {"left": frame}), record, 0, complete=True)
    soon_ns = start_ns + round(1.05e9 / rate_hz)  # when the next pair is in memory
    assert telemetry.rate_hz(soon_ns) == pytest.approx(rate_hz)
    assert telemetry.rate_hz(soon_ns + 10_000_000_000) == 0.0


def test_all_durations_count_and_the_latest_make_the_percentiles() -> None:
    durations = DurationSamples()
    assert durations.percentiles() == {"p50": None, "p99": None}
    for _ in range(1 << 14):
        durations.add_ns(1_000_000)
    for _ in range(1 << 14):
        durations.add_ns(3_000_000)
    assert durations.percentiles() == {"p50": 3.0, "p99": 3.0}
    assert durations.count == 1 << 15
    assert durations.sum_ms == pytest.approx(4.0 * (1 << 14))
