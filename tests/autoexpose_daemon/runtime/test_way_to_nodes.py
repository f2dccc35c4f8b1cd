"""What counts as the daemon's latency, and what does not."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from autoexpose_daemon.runtime.way_to_nodes import Command, WayToNodes
from autoexpose_daemon.status.document import DurationStatus, Status
from autoexpose_daemon.status.durations import DURATIONS
from autoexpose_daemon.status.telemetry import DurationSamples, Telemetry
from drivers.exposure import ExposureSetting
from drivers.frames import Side
from drivers.rig.events import Written
from tests.soak import camera
from tests.soak.clock import MS, SECOND
from tests.soak.rig import PERIOD_NS, VirtualRig
from tests.soak.wire import Wire

SETTING = ExposureSetting(1000.0, 0.0)
NEWER = ExposureSetting(2000.0, 0.0)


def written(side: Side, asked: ExposureSetting, started_ms: float, finished_ms: float) -> Written:
    return Written(side, asked, asked, round(started_ms * MS), round(finished_ms * MS))


def commanded(setting: ExposureSetting, arrival_ms: float, decided_ms: float) -> Command:
    return Command(setting, round(arrival_ms * MS), round(decided_ms * MS), held=False)


def test_a_write_is_timed_from_its_own_frame() -> None:
    telemetry = Telemetry()
    way = WayToNodes(telemetry)
    way.decided(commanded(SETTING, 10.0, 15.0), ["left", "right"])
    way.decided(commanded(NEWER, 26.0, 31.0), ["left", "right"])
    assert way.written(written("left", SETTING, 17.0, 34.0)) is not None  # so slow that a newer one is decided on
    way.written(written("left", NEWER, 34.0, 35.0))
    way.written(written("right", NEWER, 31.5, 32.0))  # it never got the first
    assert telemetry.held_ms.sum_ms == 2.0 + 3.0 + 0.5
    assert telemetry.write_ms.sum_ms == 17.0 + 1.0 + 0.5
    assert telemetry.frame_to_node_ms.sum_ms == 24.0 + 9.0 + 6.0


def test_what_no_decision_caused_is_not_timed() -> None:
    telemetry = Telemetry()
    way = WayToNodes(telemetry)
    assert way.written(written("left", SETTING, 1.0, 2.0)) is None  # the first write
    way.decided(commanded(SETTING, 10.0, 15.0), ["left"])
    way.gone("left")
    assert way.written(written("left", SETTING, 8000.0, 8001.0)) is None
    way.decided(commanded(NEWER, 9000.0, 9005.0), ["left"])
    way.written(written("left", NEWER, 9005.0, 9006.0))
    assert way.written(written("left", NEWER, 9500.0, 9501.0)) is None
    assert telemetry.frame_to_node_ms.count == telemetry.write_ms.count == telemetry.held_ms.count == 1


def test_a_camera_that_comes_back_is_no_slow_write() -> None:
    rig = VirtualRig(1, lambda _pair, _decision: None, lambda _now_ns, _health: None)
    wire = Wire(rig, 2 * SECOND)
    left, right = rig.devices
    for seconds in (5, 13):
        rig.run(wire.actors, seconds * SECOND)
        left.vanish()
        rig.run(wire.actors, (seconds + 2) * SECOND)
        right.vanish()  # from here on nothing is decided
        rig.run(wire.actors, (seconds + 5) * SECOND)
        left.present = right.present = True
    rig.run(wire.actors, 21 * SECOND)
    telemetry = rig.control.telemetry
    assert telemetry.counts.reconnects == 4
    assert telemetry.frame_to_node_ms.count > 50
    assert telemetry.frame_to_node_ms.latest_ms.max() < 2 * PERIOD_NS / MS


def test_the_parts_make_up_the_whole() -> None:
    rig = VirtualRig(2, lambda _pair, _decision: None, lambda _now_ns, _health: None)
    rig.run(Wire(rig, 2 * SECOND).actors, 20 * SECOND)
    telemetry = rig.control.telemetry
    steps, writes = telemetry.decision_ms, telemetry.frame_to_node_ms
    assert telemetry.pairing_ms.count == steps.count > writes.count / 2 == telemetry.held_ms.count / 2
    before_ms = (telemetry.pairing_ms.sum_ms + steps.sum_ms) / steps.count
    after_ms = (telemetry.held_ms.sum_ms + telemetry.write_ms.sum_ms) / writes.count
    assert np.isclose(writes.sum_ms / writes.count, before_ms + after_ms, rtol=0.1)


def test_quick_writes_shorten_the_time_that_decisions_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """A readout so slow that many a decision is ready within 5 ms of the next exposure."""
    monkeypatch.setattr(camera, "READOUT_NS", 8 * MS)
    rig = VirtualRig(3, lambda _pair, _decision: None, lambda _now_ns, _health: None)
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
