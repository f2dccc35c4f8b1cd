"""A camera that sees less light: its gain counts less what makes up for that, in limits, writes and what it reads."""

from __future__ import annotations

import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.dialect import ExposureDialect, find_dialect
from imaging.errors import ConfigurationError
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.gain_scale import GainScale
from tests.drivers.genicam.node_map import FloatNode, IntegerNode, MemoryNodes, Node

SCALE = GainScale("GainRaw", (1.0, 2.0, 4.0, 16.0), (0.0, 6.02, 12.04, 24.08))
offsets = st.floats(-8.0, 8.0)


def camera(gain: Node, node: str = "Gain") -> MemoryNodes:
    return MemoryNodes({"ExposureTime": FloatNode(5000.0, 20.0, 1e5, "us"), node: gain})


def offset_dialect(nodes: MemoryNodes, offset_stops: float, scale: GainScale | None = None) -> ExposureDialect:
    return find_dialect(nodes, scale, offset_stops=offset_stops)


def held(nodes: MemoryNodes, node: str = "Gain") -> float:
    return float(nodes.read(node))  # type: ignore[arg-type]


def test_a_filter_of_two_stops_is_made_up_for_by_gain_and_not_by_time() -> None:
    nodes = camera(FloatNode(0.0, 0.0, 36.0, "dB"))
    dialect = offset_dialect(nodes, 2.0)
    assert dialect.limitations == ()
    assert dialect.limits(nodes) == ExposureLimits(20.0, 1e5, -2 * DB_PER_STOP, 36.0 - 2 * DB_PER_STOP)
    assert dialect.write(nodes, ExposureSetting(1000.0, 0.0), None) == ExposureSetting(1000.0, 0.0)
    assert (nodes.read("ExposureTime"), held(nodes)) == (1000.0, pytest.approx(12.04, abs=0.01))
    nodes.nodes["Gain"] = FloatNode(36.0, 0.0, 36.0, "dB")
    assert dialect.read(nodes).gain_db == pytest.approx(23.96, abs=0.01)
    assert dialect.gain is not None
    assert dialect.gain.ours(20.0) == pytest.approx(20.0 - 2 * DB_PER_STOP)  # what its chunks say


def test_a_camera_that_sees_more_light_has_less_gain_than_the_others() -> None:
    nodes = camera(FloatNode(0.0, 0.0, 36.0, "dB"))
    limits = offset_dialect(nodes, -1.0).limits(nodes)
    assert (limits.min_gain_db, limits.max_gain_db) == pytest.approx((6.02, 42.02), abs=0.01)
    offset_dialect(nodes, -1.0).write(nodes, ExposureSetting(1000.0, 10.0), None)
    assert held(nodes) == pytest.approx(3.98, abs=0.01)


@given(offsets, st.floats(-60.0, 60.0), st.floats(0.0, 60.0), st.floats(0.0, 1.0))
def test_what_is_written_is_read_back_and_a_limit_stays_one(
    offset_stops: float, low: float, room: float, part: float
) -> None:
    nodes = camera(FloatNode(low, low, low + room + 0.1, "dB"))
    dialect = offset_dialect(nodes, offset_stops)
    limits = dialect.limits(nodes)
    between_db = limits.min_gain_db + part * (limits.max_gain_db - limits.min_gain_db)
    for gain_db in (limits.min_gain_db, between_db, limits.max_gain_db):
        asked = ExposureSetting(1000.0, gain_db)
        taken = dialect.write(nodes, asked, None)
        assert taken.gain_db == pytest.approx(gain_db, abs=1e-9)
        assert held(nodes) - taken.gain_db == pytest.approx(offset_stops * DB_PER_STOP, abs=1e-9)


@given(offsets, st.floats(0.2, 6.0))
def test_gains_in_steps_stay_on_the_steps_of_the_other_camera(offset_stops: float, step_db: float) -> None:
    other = camera(FloatNode(0.0, 0.0, 60.0, "dB", step_db))
    filtered = camera(FloatNode(0.0, 0.0, 60.0, "dB", step_db))
    dialect, plain = offset_dialect(filtered, offset_stops), find_dialect(other)
    common = plain.limits(other).within(dialect.limits(filtered))
    for level in (9.0, 13.3, 17.0):
        setting = common.realise(level, 1000.0)
        assert dialect.write(filtered, setting, None).agrees_with(plain.write(other, setting, None))
        steps = held(filtered) / step_db
        assert steps == pytest.approx(round(steps), abs=1e-6)
        assert held(filtered) - held(other) == pytest.approx(offset_stops * DB_PER_STOP, abs=step_db / 2 + 1e-6)


def test_what_coarse_steps_cannot_make_up_for_is_said() -> None:
    nodes = camera(IntegerNode(0, 0, 24, "dB", 6))
    (limitation,) = offset_dialect(nodes, 1.5).limitations
    assert all(words in limitation for words in ("offset_stops 1.5", "9.03 dB", "12.00 dB", "steps of 6 dB"))
    assert offset_dialect(nodes, 1.5).write(nodes, ExposureSetting(1000.0, 0.0), None).gain_db == 0.0
    assert nodes.read("Gain") == 12


@pytest.mark.parametrize("low", [-sys.float_info.max, float(-(1 << 63))])
def test_a_camera_that_declares_no_least_gain_has_an_offset_as_well(low: float) -> None:
    nodes = camera(FloatNode(0.0, low, 24.0, "dB", 0.4))
    limits = offset_dialect(nodes, 2.0).limits(nodes).within(ExposureLimits(20.0, 7500.0, 0.0, 30.0))
    assert limits.max_gain_db == pytest.approx(12.0)  # 30 steps of 0.4 dB are the nearest to two stops
    assert offset_dialect(nodes, 2.0).write(nodes, limits.darkest, None).gain_db == pytest.approx(0.0)
    assert held(nodes) == pytest.approx(12.0)


@given(offsets)
def test_a_gain_in_its_own_numbers_has_both_its_scale_and_an_offset(offset_stops: float) -> None:
    nodes = camera(IntegerNode(1, 1, 1023), "GainRaw")
    dialect = offset_dialect(nodes, offset_stops, SCALE)
    limits, offset_db = dialect.limits(nodes), offset_stops * DB_PER_STOP
    assert (limits.min_gain_db, limits.max_gain_db) == pytest.approx((-offset_db, 24.08 - offset_db))
    assert limits.gains_db[:3] == pytest.approx((-offset_db, 6.02 - offset_db, 9.03 - offset_db))
    for gain_db in limits.gains_db:
        assert dialect.write(nodes, ExposureSetting(1000.0, gain_db), None).gain_db == pytest.approx(gain_db)
        assert SCALE.gain_db(held(nodes, "GainRaw")) == pytest.approx(gain_db + offset_db)


def test_what_is_there_when_a_camera_is_opened_is_kept() -> None:
    nodes = camera(FloatNode(7.0, 0.0, 24.0, "dB"))
    dialect = offset_dialect(nodes, 2.0)
    settled = dialect.settle(nodes, dialect.limits(nodes))
    assert (held(nodes), settled.gain_db) == pytest.approx((7.0, 7.0 - 2 * DB_PER_STOP))
    nodes.nodes["Gain"] = FloatNode(math.nan, 0.0, 24.0, "dB")
    assert dialect.settle(nodes, dialect.limits(nodes)).gain_db == pytest.approx(-2 * DB_PER_STOP)
    assert held(nodes) == pytest.approx(0.0)


@pytest.mark.parametrize("gain, words", [("GainRaw", "calibrate gain --camera M1"), ("Other", "no gain node")])
def test_an_offset_needs_a_gain_that_is_driven(gain: str, words: str) -> None:
    nodes = camera(IntegerNode(0, 0, 240), gain)
    with pytest.raises(ConfigurationError, match="offset_stops") as refused:
        offset_dialect(nodes, 2.0)
    assert words in str(refused.value)
    assert offset_dialect(nodes, 0.0).gain is None
