from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.dialect import find_dialect
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.gain_scale import GainScale
from tests.drivers.genicam.node_map import FloatNode, IntegerNode, MemoryNodes

COARSE = GainScale("GainRaw", (1.0, 2.0, 4.0, 16.0), (0.0, 6.02, 12.04, 24.08))
FINE = GainScale("GainRaw", (0.0, 1000.0), (0.0, 30.0))
rises = st.lists(st.floats(0.01, 10.0), min_size=2, max_size=20)


def raw_camera(low: int = 0, high: int = 1023) -> MemoryNodes:
    return MemoryNodes({"ExposureTimeAbs": FloatNode(5000.0, 20.0, 2e5), "GainRaw": IntegerNode(7, low, high)})


@given(rises, rises, st.floats(0.0, 1.0))
def test_there_and_back(steps: list[float], rise_db: list[float], part: float) -> None:
    count = min(len(steps), len(rise_db))
    settings = tuple(sum(steps[:n]) for n in range(count))
    scale = GainScale("GainRaw", settings, tuple(sum(rise_db[:n]) for n in range(count)))
    setting = settings[0] + part * (settings[-1] - settings[0])
    assert scale.setting(scale.gain_db(setting)) == pytest.approx(setting, abs=1e-6)


def test_a_calibrated_gain_is_driven_in_db_within_what_was_measured() -> None:
    nodes = raw_camera()
    dialect = find_dialect(nodes, FINE)
    assert dialect.limitations == ()
    assert dialect.limits(nodes) == ExposureLimits(20.0, 2e5, 0.0, 30.0)
    assert dialect.write(nodes, ExposureSetting(100.0, 6.01), None) == ExposureSetting(100.0, pytest.approx(6.0))
    assert nodes.writes == [("ExposureTimeAbs", 100.0), ("GainRaw", 200)]


def test_coarse_steps_are_limits_that_control_keeps() -> None:
    nodes = raw_camera(1, 16)
    limits = find_dialect(nodes, COARSE).limits(nodes)
    assert limits.gains_db[:4] == pytest.approx((0.0, 6.02, 9.03, 12.04))
    assert len(limits.gains_db) == 16
    common = limits.within(ExposureLimits(20.0, 7500.0, 3.0, 20.0))
    assert (common.min_gain_db, common.max_gain_db) == (common.gains_db[0], common.gains_db[-1])
    assert common.min_gain_db == pytest.approx(6.02)
    for level in (14.0, 15.0, 15.7):
        setting = common.realise(level, 7500.0)
        assert setting.gain_db in common.gains_db
        assert setting.level == pytest.approx(level, abs=1e-6)
        taken = find_dialect(nodes, COARSE).write(nodes, setting, None)
        assert taken.agrees_with(setting)


def test_a_rig_takes_the_gains_of_the_coarser_camera() -> None:
    coarse = ExposureLimits(20.0, 7500.0, 0.0, 12.0, gains_db=(0.0, 6.0, 12.0))
    finer = ExposureLimits(20.0, 7500.0, 0.0, 12.0, gains_db=tuple(map(float, range(13))))
    assert finer.within(coarse).gains_db == coarse.gains_db == coarse.within(finer).gains_db


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        ({"Gain": FloatNode(0.0, 0.0, 30.0, "dB")}, "its Gain is in dB already"),
        ({"Gain": FloatNode(0.0, 0.0, 30.0)}, "its gain is Gain, not GainRaw"),
        ({}, "it has no gain that is a number"),
    ],
)
def test_a_scale_for_another_gain_is_refused(gain: dict[str, FloatNode], words: str) -> None:
    nodes = MemoryNodes({"ExposureTimeAbs": FloatNode(5000.0, 20.0, 2e5), **gain})
    with pytest.raises(ConfigurationError, match=words):
        find_dialect(nodes, FINE)
