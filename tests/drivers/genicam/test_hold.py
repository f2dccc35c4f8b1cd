"""Nodes are written only where they hold another value, and refused by name where they cannot be written."""

from __future__ import annotations

import pytest

from drivers.genicam.nodes import fixed_selectors, hold, offered, switch
from drivers.setup import FeatureValue
from imaging.errors import NodeError
from tests.drivers.genicam.node_map import (
    BooleanNode,
    EnumerationNode,
    FloatNode,
    IntegerNode,
    MemoryNodes,
    Node,
    StringNode,
)

LOCKED = EnumerationNode("All", ("All", "Tap1"), locked=True)
VALUES: list[tuple[Node, FeatureValue, FeatureValue]] = [
    (FloatNode(5.0), 5.0, 6.0),
    (IntegerNode(5), 5, 6),
    (BooleanNode(True), True, False),
    (EnumerationNode("Off", ("Off", "On")), "Off", "On"),
    (StringNode("left"), "left", "right"),
]


@pytest.mark.parametrize(("node", "present", "other"), VALUES)
def test_only_another_value_is_written(node: Node, present: FeatureValue, other: FeatureValue) -> None:
    nodes = MemoryNodes({"Feature": node})
    hold(nodes, "Feature", present)
    assert nodes.writes == []
    hold(nodes, "Feature", other)
    assert nodes.writes == [("Feature", other)]


def test_what_is_read_only_is_left_alone_or_refused_by_name_with_what_it_holds() -> None:
    nodes = MemoryNodes({"GainSelector": LOCKED})
    hold(nodes, "GainSelector", "All")
    with pytest.raises(NodeError, match="camera M1: its GainSelector is All and cannot be Tap1, as it is read-only"):
        hold(nodes, "GainSelector", "Tap1")
    assert nodes.writes == []


@pytest.mark.parametrize(
    ("node", "off", "on"),
    [
        (EnumerationNode("Continuous", ("Off", "Once", "On")), "Off", "On"),
        (EnumerationNode("Yes", ("No", "Yes")), "No", "Yes"),
        (BooleanNode(True), False, True),
        (IntegerNode(1), 0, 1),
    ],
)
def test_a_switch_may_be_of_three_kinds(node: Node, off: FeatureValue, on: FeatureValue) -> None:
    nodes = MemoryNodes({"GainAuto": node})
    switch(nodes, "GainAuto", False)
    switch(nodes, "GainAuto", True)
    assert nodes.writes == [("GainAuto", off), ("GainAuto", on)]


def test_what_is_no_switch_is_refused_with_what_it_has() -> None:
    with pytest.raises(NodeError, match="camera M1: its GainAuto has no Off, only Once, Continuous"):
        switch(MemoryNodes({"GainAuto": EnumerationNode("Once", ("Once", "Continuous"))}), "GainAuto", False)
    with pytest.raises(NodeError, match="camera M1: it has no ChunkEnable"):
        switch(MemoryNodes({}), "ChunkEnable", True)


def test_a_read_only_selector_offers_only_the_entry_at_which_it_stands() -> None:
    nodes = MemoryNodes({"GainSelector": LOCKED, "LineSelector": EnumerationNode("Line1", ("Line0", "Line1"))})
    assert offered(nodes, "GainSelector") == ("All",)
    assert offered(nodes, "LineSelector") == ("Line0", "Line1")
    assert offered(nodes, "TriggerSelector") == ()
    assert list(fixed_selectors(nodes)) == ["its GainSelector is read-only and stays at All: left alone are Tap1"]
