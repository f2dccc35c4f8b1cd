"""How a trigger is armed, on node maps in memory."""

from __future__ import annotations

import pytest

from drivers.camera import PtpState
from drivers.genicam.trigger import PtpNodes, action_queue, arm_trigger, timing_limitations
from drivers.setup import TriggerSetup
from imaging.errors import AutoexposeError, ConfigurationError, NodeError, UnsupportedCameraError
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
PTP = TriggerSetup("ptp", rate_hz=60.0)
PRIMARY = TriggerSetup("free_run", rate_hz=60.0, output_line="Line1")
KEYS = [("ActionDeviceKey", 0xAE), ("ActionGroupKey", 1), ("ActionGroupMask", 1)]


def lines(source: tuple[str, ...] = ("Off", "ExposureActive")) -> dict[str, Node]:
    return {
        "LineSelector": EnumerationNode("Line0", ("Line0", "Line1", "Line2")),
        "LineMode": EnumerationNode("Input", ("Input", "Output")),
        "LineSource": EnumerationNode("Off", source),
    }


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


def takes_actions(selector: Node, *sources: str, **others: Node) -> MemoryNodes:
    return triggered(
        TriggerSource=EnumerationNode("Line0", ("Line0", *(sources or ("Action1",)))),
        ActionSelector=selector,
        **{name: IntegerNode(0) for name, _ in KEYS},
        **others,
    )


def sources(*entries: str) -> EnumerationNode:
    return EnumerationNode(entries[0], entries)


def selector_at(entry: str) -> EnumerationNode:
    return EnumerationNode(entry, ("AcquisitionStart", "FrameStart"), locked=True)


@pytest.mark.parametrize(
    ("nodes", "setup", "kind", "words"),
    [
        (triggered(), TriggerSetup("external", "Line7"), ConfigurationError, "'Line7'; it has Line0, Line3"),
        (triggered(TriggerSource=sources("Software")), LINE0, UnsupportedCameraError, "no hardware trigger line"),
        (triggered(TriggerSelector=sources("LineStart")), LINE0, UnsupportedCameraError, "no FrameStart .*LineStart$"),
        (triggered(TriggerSelector=selector_at("AcquisitionStart")), LINE0, UnsupportedCameraError, "sitionStart$"),
        (triggered(), SOFTWARE, UnsupportedCameraError, "no software trigger"),
        (triggered(TriggerSource=sources("Line0")), SOFTWARE, UnsupportedCameraError, "no software trigger"),
        (triggered(), PTP, UnsupportedCameraError, "no ActionDeviceKey"),
        (takes_actions(IntegerNode(1), "ActionSignal"), PTP, UnsupportedCameraError, "no TriggerSource Action1"),
        (triggered(), PRIMARY, ConfigurationError, r"no output line 'Line1'; it has no LineSelector"),
        (triggered(**lines()), TriggerSetup("free_run", output_line="Line7"), ConfigurationError, "has Line0, Line1"),
        (triggered(**lines(("Off",))), PRIMARY, UnsupportedCameraError, "Line1 cannot signal"),
        (MemoryNodes({"AcquisitionFrameRate": FloatNode(30.0, 1.0, 50.0)}), FREE_RUN, ConfigurationError, "1 to 50 Hz"),
        (MemoryNodes({}), FREE_RUN, UnsupportedCameraError, "no AcquisitionFrameRate"),
        (triggered(AcquisitionFrameRate=FloatNode(30.0, 1.0, 200.0, "Hz", locked=True)), FREE_RUN, ConfigurationError,
         "AcquisitionFrameRate is 30 Hz and cannot be written"),
        (triggered(AcquisitionMode=EnumerationNode("SingleFrame", ("SingleFrame", "Continuous"), locked=True)), LINE0,
         NodeError, "AcquisitionMode is SingleFrame and cannot be Continuous"),
    ],
)  # fmt: skip
def test_what_a_camera_lacks_is_refused_by_serial_and_name(
    nodes: MemoryNodes, setup: TriggerSetup, kind: type[AutoexposeError], words: str
) -> None:
    with pytest.raises(kind, match=f"camera M1: .*{words}"):
        arm_trigger(nodes, setup)


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
        TriggerSelector=selector_at("FrameStart"),
        TriggerSource=EnumerationNode("Line0", ("Line0", "Line3"), locked=True),
    )
    assert arm_trigger(nodes, LINE0) == ()
    assert {"TriggerSelector", "TriggerSource"}.isdisjoint(name for name, _ in nodes.writes)
    with pytest.raises(ConfigurationError, match="no trigger line 'Line3'; it has Line0"):
        arm_trigger(nodes, TriggerSetup("external", "Line3"))


def test_what_is_missing_or_read_only_and_not_needed_is_a_limitation() -> None:
    nodes = triggered(
        TriggerActivation=EnumerationNode("FallingEdge", ("FallingEdge", "RisingEdge"), locked=True),
        AcquisitionFrameRateEnable=BooleanNode(True, locked=True),
        TriggerOverlap=sources("Off"),
    )
    of_rate, of_edge, of_overlap = arm_trigger(nodes, LINE0)
    assert "AcquisitionFrameRateEnable is True and cannot be False" in of_rate
    assert "it is triggered by FallingEdge" in of_edge
    assert "no TriggerOverlap ReadOut" in of_overlap
    bare = MemoryNodes({"AcquisitionFrameRate": FloatNode(30.0, 1.0, 50.0)})
    (of_lines,) = arm_trigger(bare, TriggerSetup("free_run", rate_hz=20.0))
    assert "no hardware trigger line" in of_lines


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
    nodes = triggered(TriggerMode=EnumerationNode("", ()))  # a selector whose triggers have no mode
    arm_trigger(nodes, FREE_RUN)
    assert not any(name == "TriggerMode" for name, _ in nodes.writes)


@pytest.mark.parametrize("selector", [IntegerNode(7), EnumerationNode("Action2", ("Action1", "Action2"))])
def test_action_commands_are_armed_with_both_keys_and_the_mask(selector: IntegerNode | EnumerationNode) -> None:
    nodes = takes_actions(selector)
    assert arm_trigger(nodes, PTP) == ()
    assert selector.value in (1, "Action1")
    assert [write for write in nodes.writes if write in KEYS] == KEYS
    assert nodes.writes[-3:] == [("TriggerSource", "Action1"), ("TriggerOverlap", "ReadOut"), ("TriggerMode", "On")]
    assert action_queue(nodes) == 1
    assert action_queue(takes_actions(selector, ActionQueueSize=IntegerNode(4))) == 4


@pytest.mark.parametrize(
    ("nodes", "setup", "last_writes"),
    [
        (triggered(AcquisitionMode=sources("SingleFrame", "Continuous")), FREE_RUN,
         [("AcquisitionFrameRateEnable", True), ("AcquisitionFrameRate", 60.0)]),
        (triggered(AcquisitionFrameRateEnable=BooleanNode(True)), TriggerSetup("free_run", rate_hz=None),
         [("AcquisitionFrameRateEnable", False)]),
        (triggered(AcquisitionFrameRate=FloatNode(60.0, 1.0, 200.0, "Hz", locked=True)), FREE_RUN,
         [("AcquisitionFrameRateEnable", True)]),
        (triggered(TriggerSource=EnumerationNode("Freerun", ("Freerun", "Line1", "FixedRate"))), FREE_RUN,
         [("TriggerSource", "FixedRate"), ("TriggerMode", "On"), ("AcquisitionFrameRate", 60.0)]),
        (triggered(**lines()), PRIMARY,
         [("LineSelector", "Line1"), ("LineMode", "Output"), ("LineSource", "ExposureActive")]),
        (triggered(TriggerSoftware=CommandNode(), TriggerSource=sources("Line0", "Software")), SOFTWARE,
         [("TriggerSource", "Software"), ("TriggerOverlap", "ReadOut"), ("TriggerMode", "On")]),
    ],
    ids=["at a rate", "as fast as it can", "at the fixed rate", "by a source", "primary", "software"],
)  # fmt: skip
def test_other_modes(nodes: MemoryNodes, setup: TriggerSetup, last_writes: list[tuple[str, object]]) -> None:
    assert arm_trigger(nodes, setup) == ()
    assert nodes.writes[-len(last_writes) :] == last_writes
    assert nodes.read("TriggerMode") == ("On" if ("TriggerMode", "On") in last_writes else "Off")
    assert not nodes.exists("AcquisitionMode") or nodes.read("AcquisitionMode") == "Continuous"


def test_older_names_of_the_frame_rate_are_known() -> None:
    nodes = MemoryNodes(
        {
            "AcquisitionFrameRateAuto": EnumerationNode("Continuous", ("Off", "Continuous")),
            "AcquisitionFrameRateEnabled": BooleanNode(),
            "AcquisitionFrameRateAbs": FloatNode(30.0, 1.0, 200.0),
        }
    )
    arm_trigger(nodes, FREE_RUN)
    assert [value for _, value in nodes.writes] == ["Off", True, 60.0]


@pytest.mark.parametrize(
    ("readout_us", "overlap", "name", "words"),
    [
        (8000.0, "Off", "SensorReadoutTime", "exposure.max_time_us to 2000"),
        (8000.0, "Off", "ReadoutTimeAbs", "exposure.max_time_us to 2000"),
        (12_000.0, "ReadOut", "SensorReadoutTime", "a readout of 12000 us does not fit"),
        (2000.0, "Off", "SensorReadoutTime", None),
        (8000.0, "ReadOut", "SensorReadoutTime", None),
        (8000.0, "Off", "NoSuchTime", None),
    ],
)
def test_exposure_and_readout_that_do_not_fit_are_reported_with_what_would(
    readout_us: float, overlap: str, name: str, words: str | None
) -> None:
    nodes = MemoryNodes({"TriggerOverlap": EnumerationNode(overlap, ("Off", "ReadOut")), name: FloatNode(readout_us)})
    said = timing_limitations(nodes, TriggerSetup("external", rate_hz=100.0, longest_exposure_us=7500.0))
    assert (said == ()) == (words is None)
    assert words is None or words in said[0]


SLAVE = EnumerationNode("Slave", ("Disabled", "Listening", "Slave"))


def test_the_ptp_nodes_of_sfnc_are_latched_before_they_are_read() -> None:
    nodes: dict[str, Node] = {
        "PtpEnable": BooleanNode(),
        "PtpStatus": EnumerationNode("Disabled", SLAVE.entries),
        "PtpOffsetFromMaster": IntegerNode(0),
    }

    def latch() -> None:
        nodes["PtpStatus"], nodes["PtpOffsetFromMaster"] = SLAVE, IntegerNode(-1500)

    memory = MemoryNodes(nodes | {"PtpDataSetLatch": CommandNode(latch)})
    nodes = memory.nodes
    ptp = PtpNodes(memory)
    assert memory.writes == [("PtpEnable", True)]
    assert ptp.limitations == ()
    assert (ptp.read(), str(ptp.read())) == (PtpState("Slave", -1500), "Slave -1.5 us")


def test_older_names_of_ptp_nodes_are_known_and_an_offset_may_lack_its_sign_or_be_missing() -> None:
    nodes: dict[str, Node] = {
        "GevIEEE1588": BooleanNode(),
        "GevIEEE1588DataSetLatch": CommandNode(),
        "GevIEEE1588Status": EnumerationNode("Disabled", SLAVE.entries),
        "GevIEEE1588StatusLatched": SLAVE,
        "GevIEEE1588OffsetFromMasterLatched": IntegerNode((1 << 64) - 700),
    }
    assert PtpNodes(MemoryNodes(nodes)).read() == PtpState("Slave", -700)
    del nodes["GevIEEE1588OffsetFromMasterLatched"]
    ptp = PtpNodes(MemoryNodes(nodes))
    assert "no PtpOffsetFromMaster" in ptp.limitations[0]
    assert ptp.read() == PtpState("Slave", None)


def test_a_camera_without_a_ptp_clock_is_refused_by_serial_and_node() -> None:
    for nodes, missing in (
        (MemoryNodes({}), "PtpEnable or GevIEEE1588"),
        (MemoryNodes({"PtpEnable": BooleanNode()}), "PtpStatus"),
    ):
        with pytest.raises(UnsupportedCameraError, match=f"camera M1: it has no {missing}"):
            PtpNodes(nodes)
