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


@pytest.mark.parametrize(
    ("node", "present", "other"),
    [
        (FloatNode(5.0), 5.0, 6.0),
        (IntegerNode(5), 5, 6),
        (BooleanNode(True), True, False),
        (EnumerationNode("Off", ("Off", "On")), "Off", "On"),
        (StringNode("left"), "left", "right"),
    ],
)
def test_only_another_value_is_written(node: Node, present: FeatureValue, other: FeatureValue) -> None:
    nodes = MemoryNodes({"Feature": node})
    hold(nodes, "Feature", present)
    assert nodes.writes == []
    hold(nodes, "Feature", other)
    assert nodes.writes == [("Feature", other)]


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


def test_what_cannot_be_had_is_refused_by_name_with_what_there_is() -> None:
    with pytest.raises(NodeError, match="M1: its GainAuto has no Off, only Once, Continuous"):
        switch(MemoryNodes({"GainAuto": EnumerationNode("Once", ("Once", "Continuous"))}), "GainAuto", False)
    with pytest.raises(NodeError, match="M1: it has no ChunkEnable"):
        switch(MemoryNodes({}), "ChunkEnable", True)
    nodes = MemoryNodes({"GainSelector": LOCKED})
    hold(nodes, "GainSelector", "All")
    with pytest.raises(NodeError, match="M1: its GainSelector is All and cannot be Tap1"):
        hold(nodes, "GainSelector", "Tap1")
    assert nodes.writes == []


def test_a_read_only_selector_offers_only_the_entry_at_which_it_stands() -> None:
    nodes = MemoryNodes({"GainSelector": LOCKED, "LineSelector": EnumerationNode("Line1", ("Line0", "Line1"))})
    assert [offered(nodes, name) for name in ("GainSelector", "LineSelector", "TriggerSelector")] == [
        ("All",), ("Line0", "Line1"), ()
    ]  # fmt: skip
    (fixed,) = fixed_selectors(nodes)
    assert "GainSelector" in fixed and "stays at All" in fixed and fixed.endswith("Tap1")
