from __future__ import annotations

import pytest

from drivers.genicam.trigger import timing_limitations
from drivers.setup import TriggerSetup
from tests.drivers.genicam.node_map import EnumerationNode, FloatNode, MemoryNodes, Node


def camera(readout_us: float | None, overlap: str = "Off", name: str = "SensorReadoutTime") -> MemoryNodes:
    nodes: dict[str, Node] = {"TriggerOverlap": EnumerationNode(overlap, ("Off", "ReadOut"))}
    return MemoryNodes(nodes if readout_us is None else nodes | {name: FloatNode(readout_us)})


@pytest.mark.parametrize("name", ["SensorReadoutTime", "ReadoutTimeAbs"])
def test_exposure_and_readout_that_do_not_fit_are_reported_with_what_would(name: str) -> None:
    (limitation,) = timing_limitations(
        camera(8000.0, name=name), TriggerSetup("external", rate_hz=100.0, longest_exposure_us=7500.0)
    )
    assert "an exposure of 7500 us and a readout of 8000 us do not fit into a trigger period of 10000 us" in limitation
    assert "exposure.max_time_us to 2000" in limitation


@pytest.mark.parametrize(("readout_us", "overlap"), [(2000.0, "Off"), (8000.0, "ReadOut"), (None, "Off")])
def test_a_readout_that_fits_or_is_unknown_is_not_a_limitation(readout_us: float | None, overlap: str) -> None:
    setup = TriggerSetup("external", rate_hz=100.0, longest_exposure_us=7500.0)
    assert timing_limitations(camera(readout_us, overlap), setup) == ()


def test_a_readout_longer_than_the_period_never_fits() -> None:
    (limitation,) = timing_limitations(camera(12_000.0, "ReadOut"), TriggerSetup("external", rate_hz=100.0))
    assert limitation.startswith("a readout of 12000 us does not fit")
