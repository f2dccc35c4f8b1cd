from __future__ import annotations

import pytest

from drivers.genicam.dialect import switch_gamma_off
from drivers.setup import FeatureValue
from imaging.errors import NodeError
from tests.drivers.genicam.node_map import BooleanNode, FloatNode, MemoryNodes


@pytest.mark.parametrize("switch", ["GammaEnable", "GammaEnabled"])
def test_a_switch_is_switched_off(switch: str) -> None:
    nodes = MemoryNodes({switch: BooleanNode(True), "Gamma": FloatNode(0.8)})
    assert switch_gamma_off(nodes) == ()
    assert nodes.writes == [(switch, False)]


def test_without_a_switch_gamma_becomes_1() -> None:
    nodes = MemoryNodes({"Gamma": FloatNode(0.8, 0.25, 4.0)})
    assert switch_gamma_off(nodes) == ()
    assert nodes.writes == [("Gamma", 1.0)]


def test_no_gamma_and_a_gamma_of_1_are_left_alone() -> None:
    for nodes in (MemoryNodes({}), MemoryNodes({"Gamma": FloatNode(1.0)})):
        assert switch_gamma_off(nodes) == ()
        assert nodes.writes == []


def test_the_reason_why_gamma_stays_on_is_reported() -> None:
    (limitation,) = switch_gamma_off(MemoryNodes({"Gamma": FloatNode(0.5, 0.25, 0.7)}))
    assert "grey levels are not proportional to light" in limitation
    assert "could not set Gamma to 1" in limitation

    class Locked(MemoryNodes):
        def write(self, name: str, value: FeatureValue) -> None:
            raise NodeError(f"{name} is locked")

    (limitation,) = switch_gamma_off(Locked({"GammaEnable": BooleanNode(True)}))
    assert "GammaEnable is locked" in limitation
