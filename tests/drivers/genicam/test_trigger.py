from __future__ import annotations

import pytest

from drivers.genicam.trigger import action_queue, arm_trigger
from drivers.setup import TriggerSetup
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError
from tests.drivers.genicam.node_map import (
    BooleanNode,
    CommandNode,
    EnumerationNode,
    FloatNode,
    IntegerNode,
    MemoryNodes,
    Node,
)

LINE0 = TriggerSetup("external", "Line0", 60.0)
FREE_RUN = TriggerSetup("free_run", rate_hz=60.0)
SOFTWARE = TriggerSetup("software", rate_hz=60.0)


def triggered(**others: Node) -> MemoryNodes:
    nodes: dict[str, Node] = {
        "TriggerSelector": EnumerationNode("AcquisitionStart", ("AcquisitionStart", "FrameStart")),
        "TriggerMode": EnumerationNode("On", ("Off", "On")),
        "TriggerSource": EnumerationNode("Software", ("Software", "Line0", "Line3")),
        "TriggerActivation": EnumerationNode("FallingEdge", ("FallingEdge", "RisingEdge")),
        "TriggerOverlap": EnumerationNode("Off", ("Off", "ReadOut")),
        "AcquisitionFrameRate": FloatNode(30.0, 1.0, 200.0, "Hz"),
        "AcquisitionFrameRateEnable": BooleanNode(),
    }
    return MemoryNodes(nodes | others)


def test_a_line_is_armed_after_every_trigger_is_off() -> None:
    nodes = triggered()
    assert arm_trigger(nodes, LINE0) == ()
    assert nodes.writes == [
        ("TriggerMode", "Off"),
        ("TriggerSelector", "FrameStart"),
        ("TriggerSource", "Line0"),
        ("TriggerActivation", "RisingEdge"),
        ("TriggerOverlap", "ReadOut"),
        ("TriggerMode", "On"),
    ]


def test_a_read_only_selector_is_left_where_it_stands() -> None:
    nodes = triggered(
        TriggerSelector=EnumerationNode("FrameStart", ("AcquisitionStart", "FrameStart"), locked=True),
        TriggerSource=EnumerationNode("Line0", ("Line0", "Line3"), locked=True),
    )
    assert arm_trigger(nodes, LINE0) == ()
    assert {"TriggerSelector", "TriggerSource"}.isdisjoint(name for name, _ in nodes.writes)
    with pytest.raises(ConfigurationError, match="no trigger line 'Line3'; it has Line0"):
        arm_trigger(nodes, TriggerSetup("external", "Line3"))
    elsewhere = EnumerationNode("AcquisitionStart", ("AcquisitionStart", "FrameStart"), locked=True)
    with pytest.raises(UnsupportedCameraError, match=r"TriggerSelector offers AcquisitionStart$"):
        arm_trigger(triggered(TriggerSelector=elsewhere), LINE0)


def test_what_is_read_only_and_not_needed_is_a_limitation() -> None:
    nodes = triggered(
        TriggerActivation=EnumerationNode("FallingEdge", ("FallingEdge", "RisingEdge"), locked=True),
        AcquisitionFrameRateEnable=BooleanNode(True, locked=True),
    )
    of_rate, of_edge = arm_trigger(nodes, LINE0)
    assert "AcquisitionFrameRateEnable is True and cannot be False" in of_rate
    assert "it is triggered by FallingEdge" in of_edge


def test_what_is_read_only_and_needed_is_refused_by_name() -> None:
    nodes = triggered(AcquisitionMode=EnumerationNode("SingleFrame", ("SingleFrame", "Continuous"), locked=True))
    with pytest.raises(NodeError, match="AcquisitionMode is SingleFrame and cannot be Continuous"):
        arm_trigger(nodes, LINE0)
    rate = FloatNode(30.0, 1.0, 200.0, "Hz", locked=True)
    with pytest.raises(ConfigurationError, match="AcquisitionFrameRate is 30 Hz and cannot be written"):
        arm_trigger(triggered(AcquisitionFrameRate=rate), FREE_RUN)
    assert arm_trigger(triggered(AcquisitionFrameRate=rate), TriggerSetup("free_run", rate_hz=30.0)) == ()


def test_what_a_trigger_has_only_while_it_is_on_is_set_then() -> None:
    class Hiding(MemoryNodes):
        def available(self, name: str) -> bool:
            hidden = name in ("TriggerSource", "TriggerActivation") and self.read("TriggerMode") == "Off"
            return super().available(name) and not hidden

        def entries(self, name: str) -> tuple[str, ...]:
            return super().entries(name) if self.available(name) else ()

    nodes = Hiding(triggered().nodes)
    assert arm_trigger(nodes, FREE_RUN) == arm_trigger(nodes, LINE0) == ()
    held = [nodes.read(name) for name in ("TriggerSource", "TriggerActivation", "TriggerMode")]
    assert held == ["Line0", "RisingEdge", "On"]


@pytest.mark.parametrize("mode", [EnumerationNode("On", ("Off", "On")), BooleanNode(True), IntegerNode(1)])
def test_a_trigger_without_a_selector_is_switched_too(mode: Node) -> None:
    nodes = triggered(TriggerMode=mode)
    del nodes.nodes["TriggerSelector"]
    arm_trigger(nodes, FREE_RUN)
    arm_trigger(nodes, LINE0)
    assert [value for name, value in nodes.writes if name == "TriggerMode"] in (["Off", "On"], [False, True])


def test_a_software_trigger_needs_its_source_and_its_command() -> None:
    source = EnumerationNode("Line0", ("Software", "Line0"))
    nodes = triggered(TriggerSoftware=CommandNode(), TriggerSource=source)
    assert arm_trigger(nodes, SOFTWARE) == ()
    assert nodes.writes[-3:] == [("TriggerSource", "Software"), ("TriggerOverlap", "ReadOut"), ("TriggerMode", "On")]
    for bare in (triggered(), triggered(TriggerSource=EnumerationNode("Line0", ("Line0",)))):
        with pytest.raises(UnsupportedCameraError, match="camera M1: no software trigger"):
            arm_trigger(bare, SOFTWARE)


PTP = TriggerSetup("ptp", rate_hz=60.0)
KEYS = [("ActionDeviceKey", 0xAE), ("ActionGroupKey", 1), ("ActionGroupMask", 1)]


def takes_actions(selector: Node, **others: Node) -> MemoryNodes:
    keys = {name: IntegerNode(0) for name, _ in KEYS}
    return triggered(
        TriggerSource=EnumerationNode("Line0", ("Software", "Line0", "Action1")),
        ActionSelector=selector,
        **keys,
        **others,
    )


@pytest.mark.parametrize("selector", [IntegerNode(7), EnumerationNode("Action2", ("Action1", "Action2"))])
def test_action_commands_are_armed_with_both_keys_and_the_mask(selector: IntegerNode | EnumerationNode) -> None:
    nodes = takes_actions(selector)
    assert arm_trigger(nodes, PTP) == ()
    assert selector.value in (1, "Action1")
    assert [write for write in nodes.writes if write in KEYS] == KEYS
    assert nodes.writes[-3:] == [("TriggerSource", "Action1"), ("TriggerOverlap", "ReadOut"), ("TriggerMode", "On")]
    assert action_queue(nodes) == 1
    assert action_queue(takes_actions(selector, ActionQueueSize=IntegerNode(4))) == 4


def test_a_camera_without_action_commands_is_refused_by_serial_and_node() -> None:
    with pytest.raises(UnsupportedCameraError, match="camera M1: it has no ActionDeviceKey, and so takes no action"):
        arm_trigger(triggered(), PTP)
    bare = takes_actions(IntegerNode(1))
    bare.nodes["TriggerSource"] = EnumerationNode("Line0", ("Line0", "ActionSignal"))
    with pytest.raises(UnsupportedCameraError, match="camera M1: it has no TriggerSource Action1"):
        arm_trigger(bare, PTP)


def test_a_missing_overlap_is_reported() -> None:
    limitations = arm_trigger(triggered(TriggerOverlap=EnumerationNode("Off", ("Off",))), LINE0)
    assert limitations == ("no TriggerOverlap ReadOut: exposure and readout together must fit into a trigger period",)


def test_an_unknown_line_is_refused_with_those_that_exist() -> None:
    with pytest.raises(ConfigurationError, match="no trigger line 'Line7'; it has Line0, Line3"):
        arm_trigger(triggered(), TriggerSetup("external", "Line7"))


def test_cameras_without_a_line_or_a_frame_trigger_are_refused() -> None:
    with pytest.raises(UnsupportedCameraError, match="no hardware trigger line"):
        arm_trigger(triggered(TriggerSource=EnumerationNode("Software", ("Software",))), LINE0)
    with pytest.raises(UnsupportedCameraError, match="no FrameStart or ExposureStart trigger"):
        arm_trigger(triggered(TriggerSelector=EnumerationNode("LineStart", ("LineStart",))), LINE0)


def test_a_free_run_sets_the_rate_with_triggers_off() -> None:
    nodes = triggered(AcquisitionMode=EnumerationNode("SingleFrame", ("SingleFrame", "Continuous")))
    assert arm_trigger(nodes, FREE_RUN) == ()
    assert nodes.read("TriggerMode") == "Off"
    assert nodes.read("AcquisitionMode") == "Continuous"
    assert nodes.writes[-2:] == [("AcquisitionFrameRateEnable", True), ("AcquisitionFrameRate", 60.0)]


def test_a_free_run_reports_a_missing_line_and_refuses_impossible_rates() -> None:
    bare = MemoryNodes({"AcquisitionFrameRate": FloatNode(30.0, 1.0, 50.0)})
    with pytest.raises(ConfigurationError, match="cannot run at 60 Hz, only at 1 to 50 Hz"):
        arm_trigger(bare, FREE_RUN)
    assert arm_trigger(bare, TriggerSetup("free_run", rate_hz=20.0)) == (
        "no hardware trigger line: it can only run freely",
    )
    with pytest.raises(UnsupportedCameraError, match="no AcquisitionFrameRate"):
        arm_trigger(MemoryNodes({}), FREE_RUN)


def test_a_free_run_without_a_rate_is_as_fast_as_the_exposure_allows() -> None:
    nodes = triggered(AcquisitionFrameRateEnable=BooleanNode(True))
    assert arm_trigger(nodes, TriggerSetup("free_run", rate_hz=None)) == ()
    assert nodes.writes[-1] == ("AcquisitionFrameRateEnable", False)


PRIMARY = TriggerSetup("free_run", rate_hz=60.0, output_line="Line1")
LINES: dict[str, Node] = {
    "LineSelector": EnumerationNode("Line0", ("Line0", "Line1", "Line2")),
    "LineMode": EnumerationNode("Input", ("Input", "Output")),
    "LineSource": EnumerationNode("Off", ("Off", "ExposureActive")),
}


def test_a_primary_camera_runs_freely_and_signals_its_exposures() -> None:
    nodes = triggered(**LINES)
    assert arm_trigger(nodes, PRIMARY) == ()
    assert nodes.writes[-4:] == [
        ("AcquisitionFrameRate", 60.0),
        ("LineSelector", "Line1"),
        ("LineMode", "Output"),
        ("LineSource", "ExposureActive"),
    ]


def test_a_primary_camera_without_such_an_output_is_refused() -> None:
    with pytest.raises(
        ConfigurationError, match=r"no output line 'Line1'; it has no LineSelector \(trigger output_line"
    ):
        arm_trigger(triggered(), PRIMARY)
    with pytest.raises(ConfigurationError, match="no output line 'Line7'; it has Line0, Line1, Line2"):
        arm_trigger(triggered(**LINES), TriggerSetup("free_run", output_line="Line7"))
    with pytest.raises(UnsupportedCameraError, match="Line1 cannot signal when it exposes"):
        arm_trigger(triggered(**LINES | {"LineSource": EnumerationNode("Off", ("Off",))}), PRIMARY)


def test_older_names_of_the_frame_rate_are_known() -> None:
    nodes = MemoryNodes(
        {
            "AcquisitionFrameRateAuto": EnumerationNode("Continuous", ("Off", "Continuous")),
            "AcquisitionFrameRateEnabled": BooleanNode(),
            "AcquisitionFrameRateAbs": FloatNode(30.0, 1.0, 200.0),
        }
    )
    arm_trigger(nodes, FREE_RUN)
    assert nodes.writes == [
        ("AcquisitionFrameRateAuto", "Off"),
        ("AcquisitionFrameRateEnabled", True),
        ("AcquisitionFrameRateAbs", 60.0),
    ]


def test_a_fixed_rate_is_a_trigger_source_on_some_cameras() -> None:
    nodes = triggered(TriggerSource=EnumerationNode("Freerun", ("Freerun", "Line1", "FixedRate")))
    arm_trigger(nodes, FREE_RUN)
    assert nodes.read("TriggerSource") == "FixedRate"
    assert nodes.read("TriggerMode") == "On"


def test_triggers_without_a_mode_are_skipped() -> None:
    nodes = triggered(TriggerMode=EnumerationNode("", ()))
    arm_trigger(nodes, FREE_RUN)
    assert not any(name == "TriggerMode" for name, _ in nodes.writes)
