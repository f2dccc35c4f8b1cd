from __future__ import annotations

import pytest

from drivers.camera import PtpState
from drivers.genicam.trigger import PtpNodes
from imaging.errors import UnsupportedCameraError
from tests.drivers.genicam.node_map import BooleanNode, CommandNode, EnumerationNode, IntegerNode, MemoryNodes, Node

SLAVE = EnumerationNode("Slave", ("Disabled", "Listening", "Slave"))


def test_the_nodes_of_sfnc_are_latched_before_they_are_read() -> None:
    nodes: dict[str, Node] = {
        "PtpEnable": BooleanNode(),
        "PtpStatus": EnumerationNode("Disabled", SLAVE.entries),
        "PtpOffsetFromMaster": IntegerNode(0),
    }

    def latch() -> None:
        nodes["PtpStatus"], nodes["PtpOffsetFromMaster"] = SLAVE, IntegerNode(-1500)

    nodes["PtpDataSetLatch"] = CommandNode(latch)
    memory = MemoryNodes(nodes)
    ptp = PtpNodes(memory)
    assert memory.writes == [("PtpEnable", True)]
    assert ptp.limitations == ()
    assert ptp.read() == PtpState("Slave", -1500)
    assert str(ptp.read()) == "Slave -1.5 us"


def test_older_names_are_known_and_an_offset_without_sign() -> None:
    nodes: dict[str, Node] = {
        "GevIEEE1588": BooleanNode(),
        "GevIEEE1588DataSetLatch": CommandNode(),
        "GevIEEE1588Status": EnumerationNode("Disabled", SLAVE.entries),
        "GevIEEE1588StatusLatched": SLAVE,
        "GevIEEE1588OffsetFromMasterLatched": IntegerNode((1 << 64) - 700),
    }
    assert PtpNodes(MemoryNodes(nodes)).read() == PtpState("Slave", -700)


def test_a_camera_may_not_say_how_far_it_is_off() -> None:
    ptp = PtpNodes(MemoryNodes({"GevIEEE1588": BooleanNode(), "GevIEEE1588Status": SLAVE}))
    assert ptp.limitations == ("no PtpOffsetFromMaster: how far its clock is from its master's is not known",)
    assert ptp.read() == PtpState("Slave", None)


def test_a_camera_without_a_ptp_clock_is_refused_by_serial_and_node() -> None:
    with pytest.raises(UnsupportedCameraError, match="camera M1: it has no PtpEnable or GevIEEE1588, and so no clock"):
        PtpNodes(MemoryNodes({}))
    with pytest.raises(UnsupportedCameraError, match="camera M1: it has no PtpStatus or"):
        PtpNodes(MemoryNodes({"PtpEnable": BooleanNode()}))
