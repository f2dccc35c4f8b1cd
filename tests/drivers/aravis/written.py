"""Which nodes the driver writes where they do not hold the value."""

from __future__ import annotations

import pytest

from drivers.aravis.nodes import AravisNodes
from drivers.genicam.nodes import NodeMap, read_feature
from drivers.setup import FeatureValue
from imaging.errors import NodeError

SELECTORS = {
    *("TriggerSelector", "GainSelector", "ChunkSelector", "LineSelector", "ActionSelector"),
    *("TimestampLatch", "GevTimestampControlLatch", "PtpDataSetLatch"),
}
"""May be features all the same: the driver sets a selector whenever it needs it, and may latch at any time."""


def names_written(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Names of the nodes that are written from now on, as if none held its value already."""
    names: set[str] = set()

    def read_unless_writable(nodes: NodeMap, name: str) -> FeatureValue:
        if nodes.writable(name):
            raise NodeError(name)
        return read_feature(nodes, name)

    monkeypatch.setattr("drivers.genicam.nodes.read_feature", read_unless_writable)

    def noting(method: str) -> None:
        original = getattr(AravisNodes, method)

        def note(nodes: AravisNodes, name: str, *value: object) -> None:
            names.add(name)
            original(nodes, name, *value)

        monkeypatch.setattr(AravisNodes, method, note)

    for method in ("write", "execute"):
        noting(method)
    return names
