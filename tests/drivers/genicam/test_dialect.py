from __future__ import annotations

import sys

import pytest

from drivers.genicam.dialect import find_dialect, switch_auto_off, switch_gamma_off
from drivers.setup import FeatureValue
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError
from imaging.exposure import ExposureLimits, ExposureSetting
from tests.drivers.genicam.node_map import BooleanNode, EnumerationNode, FloatNode, IntegerNode, MemoryNodes, Node


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
    assert dialect.limitations == ()
    assert dialect.limits(nodes) == ExposureLimits(10.0, 1e5, 0.0, 47.0, 1.0, 0.0)
    assert dialect.write(nodes, ExposureSetting(1234.4, 6.0), None) == ExposureSetting(1234.0, 6.0)


def test_gain_without_db_is_left_alone_and_reported() -> None:
    nodes = sfnc1()
    dialect = find_dialect(nodes)
    (limitation,) = dialect.limitations
    assert "GainRaw" in limitation and "raw units" in limitation and "calibrate gain --camera M1" in limitation
    assert dialect.limits(nodes) == ExposureLimits(20.0, 2e5, 0.0, 0.0)
    assert dialect.write(nodes, ExposureSetting(100.0, 0.0), None) == ExposureSetting(100.0, 0.0)
    assert nodes.writes == [("ExposureTimeAbs", 100.0)]
    with pytest.raises(NodeError, match="no gain known in dB"):
        dialect.write(nodes, ExposureSetting(100.0, 3.0), None)


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (FloatNode(1.0), "gain (Gain) is in numbers without a unit"),
        (FloatNode(1.0, unit="%"), "gain (Gain) is in % and"),
        (EnumerationNode("Low", ("Low",)), "gain (Gain) is not a number"),
        (FloatNode(3.0, 0.0, 24.0, "dB", locked=True), "gain (Gain) cannot be written"),
        (FloatNode(3.0, 0.0, float("nan"), "dB"), "gain (Gain) has no bounds"),
        (IntegerNode(0, 0, 0), "gain (Gain) takes 0 to 0"),
        (None, "no gain node"),
    ],
)
def test_a_gain_that_cannot_be_driven_is_named_and_the_time_driven(gain: Node | None, words: str) -> None:
    nodes = sfnc2()
    del nodes.nodes["Gain"]
    nodes.nodes |= {} if gain is None else {"Gain": gain}
    dialect = find_dialect(nodes)
    assert dialect.gain is None
    assert dialect.limitations[0].startswith(words)
    dialect.write(nodes, ExposureSetting(1000.0, 0.0), None)


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ({"ExposureTime": FloatNode(1.0, unit="lines")}, "its ExposureTime is in 'lines'"),
        ({"ExposureTime": FloatNode(5000.0, 10.0, 1e6, "us", locked=True)}, "its ExposureTime cannot be written"),
        ({"ExposureTimeRaw": IntegerNode(1)}, "its ExposureTimeRaw counts in steps of unknown length"),
        ({"Shutter": FloatNode(1.0)}, "neither .* offers only Shutter"),
        ({}, "neither .* no other known exposure node"),
    ],
)
def test_a_time_that_cannot_be_driven_is_refused_by_name_unless_another_node_helps(
    time: dict[str, Node], words: str
) -> None:
    with pytest.raises(UnsupportedCameraError, match=f"camera M1: {words}"):
        find_dialect(MemoryNodes(dict(time)))
    assert find_dialect(MemoryNodes(time | {"ExposureTimeAbs": FloatNode(5000.0, 10.0)})).time.node == "ExposureTimeAbs"


def test_a_gain_in_db_is_driven_under_its_other_name_and_as_an_integer() -> None:
    nodes = sfnc2(GainAbs=IntegerNode(3, 0, 24, "dB", 2))
    del nodes.nodes["Gain"]
    dialect = find_dialect(nodes)
    assert dialect.limitations == ()
    assert dialect.limits(nodes).gain_step_db == 2.0
    assert dialect.write(nodes, ExposureSetting(5000.0, 6.7), None).gain_db == 6.0


@pytest.mark.parametrize("unit, us", [("s", 1e6), ("ms", 1e3), ("µs", 1.0), ("ns", 1e-3)])
def test_exposure_time_in_other_units_is_driven_in_microseconds(unit: str, us: float) -> None:
    nodes = sfnc2(ExposureTime=FloatNode(5000.0 / us, 10.0 / us, 1e6 / us, unit, 10.0 / us))
    dialect = find_dialect(nodes)
    limits = dialect.limits(nodes)
    assert (limits.min_time_us, limits.max_time_us, limits.time_step_us) == pytest.approx((10.0, 1e6, 10.0))
    assert dialect.write(nodes, ExposureSetting(1230.0, 3.0), None).exposure_time_us == pytest.approx(1230.0)
    assert nodes.writes[0] == ("ExposureTime", pytest.approx(1230.0 / us))
    for time_us in (limits.min_time_us, limits.max_time_us):  # a limit survives the change of units
        assert dialect.write(nodes, ExposureSetting(time_us, 3.0), None).exposure_time_us == time_us


def test_integer_exposure_times_take_the_nearest_increment() -> None:
    nodes = sfnc2(ExposureTime=IntegerNode(5000, 20, 100_000, increment=7))
    dialect = find_dialect(nodes)
    assert dialect.limits(nodes).time_step_us == 7.0
    assert dialect.write(nodes, ExposureSetting(1000.0, 3.0), None).exposure_time_us == 20 + 140 * 7
    boundless = sfnc2(ExposureTime=IntegerNode(5000, -(1 << 63)))
    assert find_dialect(boundless).write(boundless, ExposureSetting(1234.4, 3.0), None).exposure_time_us == 1234


@pytest.mark.parametrize(
    ("time", "least_us"),
    [
        (FloatNode(5000.0, 0.0, 1e5, "us"), 1.0),
        (FloatNode(5000.0, -sys.float_info.max, 1e5, "us"), 1.0),
        (FloatNode(5.0, 0.0, 100.0, "ms", 0.01), 10.0),
        (IntegerNode(5000, -(1 << 63), increment=5), 5.0),
    ],
)
def test_a_camera_that_declares_no_least_exposure_time_is_driven(time: Node, least_us: float) -> None:
    nodes = sfnc2(ExposureTime=time)
    limits = find_dialect(nodes).limits(nodes)
    assert limits.min_time_us == pytest.approx(least_us)
    assert find_dialect(nodes).write(nodes, limits.darkest, None).exposure_time_us == pytest.approx(least_us)


@pytest.mark.parametrize(
    "gain",
    [
        FloatNode(0.0, -sys.float_info.max, 24.0, "dB", 0.4),
        FloatNode(0.0, -sys.float_info.max, 24.0, "dB"),
        IntegerNode(0, -(1 << 63), 24, "dB", 2),
    ],
)
def test_a_camera_that_declares_no_least_gain_is_driven_within_the_configured_limits(gain: Node) -> None:
    nodes = sfnc2(Gain=gain)
    limits = find_dialect(nodes).limits(nodes).within(ExposureLimits(20.0, 7500.0, 4.0, 20.0))
    assert limits.min_gain_db == pytest.approx(4.0)
    assert find_dialect(nodes).write(nodes, limits.darkest, None).gain_db == pytest.approx(4.0)


def test_a_count_of_known_length_is_driven() -> None:
    nodes = MemoryNodes({"ExposureTimeRaw": IntegerNode(50, 1, 4095), "ExposureTimeBaseAbs": FloatNode(20.0)})
    dialect = find_dialect(nodes)
    assert dialect.limits(nodes).min_time_us == dialect.limits(nodes).time_step_us == 20.0
    assert dialect.write(nodes, ExposureSetting(1000.0, 0.0), None).exposure_time_us == 1000.0
    assert nodes.writes == [("ExposureTimeRaw", 50)]


def test_only_what_changed_is_written() -> None:
    nodes = sfnc2()
    dialect = find_dialect(nodes)
    present = dialect.read(nodes)
    assert dialect.write(nodes, present, present) == present
    assert nodes.writes == []
    dialect.write(nodes, ExposureSetting(5000.0, 4.0), present)
    assert nodes.writes == [("Gain", 4.0)]


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize("name", ["ExposureTime", "Gain"])
@pytest.mark.parametrize("value", [NAN, INFINITE, -INFINITE])
def test_a_node_that_reads_nan_or_inf_is_reported(name: str, value: float) -> None:
    nodes = sfnc2()
    node = nodes.nodes[name]
    assert isinstance(node, FloatNode)
    node.take = lambda _: value
    with pytest.raises(NodeError, match=f"camera M1: node {name} reads -?(nan|inf)"):
        find_dialect(nodes).write(nodes, ExposureSetting(1000.0, 3.0), None)
    nodes = sfnc2(ExposureTime=FloatNode(0.0, 10.0, 1e6, "us", take=lambda _: 0.0))
    with pytest.raises(NodeError, match="ExposureTime reads 0 us"):
        find_dialect(nodes).write(nodes, ExposureSetting(1000.0, 3.0), None)


def test_bounds_and_increments_that_are_not_numbers() -> None:
    nodes = sfnc2(ExposureTime=FloatNode(1000.0, NAN, 1e6, "us"))
    with pytest.raises(NodeError, match="the bounds of node ExposureTime are not numbers: nan to 1e"):
        find_dialect(nodes).limits(nodes)
    nodes = sfnc2(ExposureTime=FloatNode(1000.0, 10.0, INFINITE, "us", increment=NAN))
    limits = find_dialect(nodes).limits(nodes)
    assert (limits.max_time_us, limits.time_step_us) == (INFINITE, 0.0)


def test_automatic_exposure_and_gain_are_switched_off_if_present() -> None:
    nodes = sfnc2(
        ExposureAuto=EnumerationNode("Continuous", ("Off", "Once", "Continuous")),
        GainAuto=EnumerationNode("Off", ("Off", "Continuous")),
        ExposureMode=EnumerationNode("TriggerWidth", ("Timed", "TriggerWidth")),
        GainSelector=EnumerationNode("DigitalAll", ("All", "DigitalAll")),
    )
    switch_auto_off(nodes)
    assert nodes.writes == [("GainSelector", "All"), ("ExposureMode", "Timed"), ("ExposureAuto", "Off")]
    switch_auto_off(sfnc1())
    nodes = sfnc2(  # read-only, and as it should be
        ExposureAuto=EnumerationNode("Off", ("Off", "Continuous"), locked=True),
        ExposureMode=EnumerationNode("Timed", ("Timed", "TriggerWidth"), locked=True),
        GainSelector=EnumerationNode("DigitalAll", ("All", "DigitalAll"), locked=True),
    )
    switch_auto_off(nodes)
    assert nodes.writes == []


@pytest.mark.parametrize(
    ("name", "error", "reported"),
    [("ExposureTime", 0.08, False), ("ExposureTime", 0.12, True), ("Gain", 0.4, False), ("Gain", 0.6, True)],
)
def test_a_tenth_of_the_time_and_half_a_db_are_rounding(name: str, error: float, reported: bool) -> None:
    nodes = sfnc2()
    node = nodes.nodes[name]
    assert isinstance(node, FloatNode)
    node.take = lambda value: value - error * (value if name == "ExposureTime" else 1.0)
    asked = ExposureSetting(2000.0, 6.0)
    if reported:
        with pytest.raises(NodeError, match=f"node {name} was set to"):
            find_dialect(nodes).write(nodes, asked, None)
    else:
        assert find_dialect(nodes).write(nodes, asked, None) != asked


@pytest.mark.parametrize(
    ("present_us", "settled_us"),
    [(5000.0, 5000.0), (0.0, 10.0), (-3.0, 10.0), (1e9, 1e6), (NAN, 10.0), (INFINITE, 10.0)],
)
def test_a_camera_that_was_switched_on_with_anything_takes_the_nearest_it_can(
    present_us: float, settled_us: float
) -> None:
    nodes = sfnc2(ExposureTime=FloatNode(present_us, 10.0, 1e6, "us"))
    dialect = find_dialect(nodes)
    assert dialect.settle(nodes, dialect.limits(nodes)).exposure_time_us == settled_us


@pytest.mark.parametrize(
    "time", [{"ExposureTimeRaw": IntegerNode(50, 1, 4095)}, {"ExposureTime": FloatNode(1, 1, 99, "lines")}]
)
def test_counts_of_unknown_length_are_driven_once_that_is_given(time: dict[str, Node]) -> None:
    nodes = MemoryNodes(dict(time))
    with pytest.raises(UnsupportedCameraError, match="exposure_count_us"):
        find_dialect(nodes)
    dialect = find_dialect(nodes, count_us=20.0)
    assert dialect.limits(nodes).min_time_us == 20.0
    assert dialect.write(nodes, ExposureSetting(1000.0, 0.0), None).exposure_time_us == 1000.0
    assert nodes.writes == [(*time, 50)]
    nodes.nodes["ExposureTimeAbs"] = FloatNode(5000.0, 10.0)
    with pytest.raises(
        ConfigurationError, match="the unit of its ExposureTimeAbs is known: leave out exposure_count_us"
    ):
        find_dialect(nodes, count_us=20.0)


@pytest.mark.parametrize(
    ("name", "node", "words"),
    [
        ("ExposureMode", EnumerationNode("TriggerWidth", ("TriggerWidth",)), "cannot be Timed"),
        ("ExposureMode", EnumerationNode("TriggerWidth", ("Timed", "TriggerWidth"), locked=True), "cannot be Timed"),
        ("ExposureAuto", EnumerationNode("Continuous", ("Off", "Continuous"), locked=True), "is Continuous and cannot"),
        ("GainAuto", EnumerationNode("Once", ("Once", "Continuous")), "has no Off, only Once, Continuous"),
    ],
)
def test_a_camera_that_exposes_by_itself_is_refused_by_name(name: str, node: Node, words: str) -> None:
    with pytest.raises(NodeError, match=f"camera M1: its {name} .*{words}"):
        switch_auto_off(sfnc2(**{name: node}))


@pytest.mark.parametrize(
    ("gamma", "writes"),
    [
        ({"GammaEnable": BooleanNode(True), "Gamma": FloatNode(0.8)}, [("GammaEnable", False)]),
        ({"GammaEnabled": BooleanNode(True), "Gamma": FloatNode(0.8)}, [("GammaEnabled", False)]),
        ({"Gamma": FloatNode(0.8, 0.25, 4.0)}, [("Gamma", 1.0)]),
        ({"Gamma": FloatNode(1.0)}, []),
        ({}, []),
    ],
)
def test_a_gamma_is_switched_off_or_becomes_1(gamma: dict[str, Node], writes: list[tuple[str, object]]) -> None:
    nodes = MemoryNodes(gamma)
    assert switch_gamma_off(nodes) == ()
    assert nodes.writes == writes


def test_the_reason_why_gamma_stays_on_is_reported() -> None:
    (limitation,) = switch_gamma_off(MemoryNodes({"Gamma": FloatNode(0.5, 0.25, 0.7)}))
    assert "grey levels are not proportional to light" in limitation
    assert "could not set Gamma to 1" in limitation

    class Locked(MemoryNodes):
        def write(self, name: str, value: FeatureValue) -> None:
            raise NodeError(f"{name} is locked")

    (limitation,) = switch_gamma_off(Locked({"GammaEnable": BooleanNode(True)}))
    assert "GammaEnable is locked" in limitation
