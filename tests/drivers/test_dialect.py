from __future__ import annotations

import pytest

from drivers.dialect import find_dialect, switch_auto_off
from drivers.errors import NodeError, UnsupportedCameraError
from drivers.exposure import ExposureLimits, ExposureSetting
from tests.drivers.node_map import EnumerationNode, FloatNode, IntegerNode, MemoryNodes, Node


def sfnc2(**others: Node) -> MemoryNodes:
    nodes: dict[str, Node] = {
        "ExposureTime": FloatNode(5000.0, 10.0, 1e5, "us", 1.0, take=round),
        "Gain": FloatNode(3.0, 0.0, 47.0, "dB"),
    }
    return MemoryNodes(nodes | others)


def sfnc1() -> MemoryNodes:
    return MemoryNodes({"ExposureTimeAbs": FloatNode(5000.0, 20.0, 2e5), "GainRaw": IntegerNode(7)})


def test_time_and_gain_in_db_are_driven() -> None:
    nodes = sfnc2()
    dialect = find_dialect(nodes)
    assert dialect.lacks == ()
    assert dialect.limits(nodes) == ExposureLimits(10.0, 1e5, 0.0, 47.0, 1.0, 0.0)
    assert dialect.write(nodes, ExposureSetting(1234.4, 6.0), None) == ExposureSetting(1234.0, 6.0)


def test_gain_without_db_is_left_alone_and_told() -> None:
    nodes = sfnc1()
    dialect = find_dialect(nodes)
    assert dialect.lacks == ("gain has no dB scale: left at its present value, exposure time alone is driven",)
    assert dialect.limits(nodes) == ExposureLimits(20.0, 2e5, 0.0, 0.0)
    assert dialect.write(nodes, ExposureSetting(100.0, 0.0), None) == ExposureSetting(100.0, 0.0)
    assert nodes.writes == [("ExposureTimeAbs", 100.0)]
    with pytest.raises(NodeError, match="no gain in dB"):
        dialect.write(nodes, ExposureSetting(100.0, 3.0), None)


@pytest.mark.parametrize("gain", [FloatNode(1.0), FloatNode(1.0, unit="%"), IntegerNode(1)])
def test_a_gain_that_is_no_float_in_db_is_left_alone(gain: Node) -> None:
    assert find_dialect(sfnc2(Gain=gain)).gain_node is None


def test_no_gain_at_all_is_told() -> None:
    nodes = sfnc2()
    del nodes.nodes["Gain"]
    assert find_dialect(nodes).lacks == ("no gain node: exposure time alone is driven",)


@pytest.mark.parametrize(
    ("node", "words"),
    [
        (FloatNode(0.005, unit="s"), "in 's' and not in microseconds"),
        (IntegerNode(5000), "not a floating-point number"),
    ],
)
def test_exposure_times_in_other_dialects_are_refused_by_name(node: Node, words: str) -> None:
    with pytest.raises(UnsupportedCameraError, match=f"M1: its ExposureTime is {words}"):
        find_dialect(sfnc2(ExposureTime=node))


def test_a_camera_without_exposure_time_is_refused_with_what_it_offers() -> None:
    with pytest.raises(UnsupportedCameraError, match="offers only ExposureTimeRaw"):
        find_dialect(MemoryNodes({"ExposureTimeRaw": IntegerNode(1)}))
    with pytest.raises(UnsupportedCameraError, match="no other exposure node"):
        find_dialect(MemoryNodes({}))


def test_only_what_changed_is_written() -> None:
    nodes = sfnc2()
    dialect = find_dialect(nodes)
    present = dialect.read(nodes)
    assert dialect.write(nodes, present, present) == present
    assert nodes.writes == []
    dialect.write(nodes, ExposureSetting(5000.0, 4.0), present)
    assert nodes.writes == [("Gain", 4.0)]


@pytest.mark.parametrize(
    ("name", "asked"), [("ExposureTime", ExposureSetting(9000.0, 3.0)), ("Gain", ExposureSetting(5000.0, 20.0))]
)
def test_a_silent_clip_is_told(name: str, asked: ExposureSetting) -> None:
    nodes = sfnc2()
    node = nodes.nodes[name]
    assert isinstance(node, FloatNode)
    node.take = lambda value: value / 2
    with pytest.raises(NodeError, match=f"M1: node {name} was set to .* and reads back"):
        find_dialect(nodes).write(nodes, asked, None)


def test_automatics_are_switched_off_where_there_are_any() -> None:
    nodes = sfnc2(
        ExposureAuto=EnumerationNode("Continuous", ("Off", "Once", "Continuous")),
        GainAuto=EnumerationNode("Off", ("Off", "Continuous")),
        ExposureMode=EnumerationNode("TriggerWidth", ("Timed", "TriggerWidth")),
        GainSelector=EnumerationNode("DigitalAll", ("All", "DigitalAll")),
    )
    switch_auto_off(nodes)
    assert nodes.writes == [("ExposureMode", "Timed"), ("ExposureAuto", "Off"), ("GainSelector", "All")]
    switch_auto_off(sfnc1())
