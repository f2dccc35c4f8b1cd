"""What counts as the daemon's latency, and what does not."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from autoexpose_daemon.status.counters import DURATIONS
from autoexpose_daemon.status.document import DurationStatus, Status
from autoexpose_daemon.status.telemetry import DurationSamples, Telemetry
from drivers.rig.events import Written
from drivers.triggers.writes import Command
from imaging.exposure import ExposureSetting
from tests.soak import camera
from tests.soak.clock import MS, SECOND
from tests.soak.rig import PERIOD_NS, VirtualRig
from tests.soak.wire import Wire


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
