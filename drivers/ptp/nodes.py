"""The nodes of a camera's PTP clock: switching it on, and what it says about its synchronisation."""

from __future__ import annotations

from drivers.camera import PtpState
from drivers.genicam.hold import switch
from drivers.genicam.nodes import NodeMap
from drivers.genicam.trigger import PTP_SWITCHES
from imaging.errors import UnsupportedCameraError

_LATCH_NODES = ("PtpDataSetLatch", "GevIEEE1588DataSetLatch")
_STATUS_NODES = ("PtpStatus", "GevIEEE1588StatusLatched", "GevIEEE1588Status")
_OFFSET_NODES = ("PtpOffsetFromMaster", "GevIEEE1588OffsetFromMasterLatched", "GevIEEE1588OffsetFromMaster")
"""Each by its SFNC name, then by those of older descriptions."""


class PtpNodes:
    """The PTP clock of a camera, switched on.

    Raises
    ------
    UnsupportedCameraError
        At construction, when the camera has none, or one without a status.
    """

    def __init__(self, nodes: NodeMap) -> None:
        self._nodes = nodes
        switch(nodes, self._required(PTP_SWITCHES), True)
        self._status = self._required(_STATUS_NODES)
        self._latch = self._first(_LATCH_NODES)
        self._offset = self._first(_OFFSET_NODES)

    @property
    def limitations(self) -> tuple[str, ...]:
        """What it cannot do, in words."""
        if self._offset is None:
            return (f"no {_OFFSET_NODES[0]}: how far its clock is from its master's is not known",)
        return ()

    def read(self) -> PtpState:
        """How its clock is synchronised now."""
        if self._latch is not None:
            self._nodes.execute(self._latch)
        offset_ns = None if self._offset is None else self._nodes.read_integer(self._offset)
        if offset_ns is not None and offset_ns >= 1 << 63:  # some descriptions forget its sign
            offset_ns -= 1 << 64
        return PtpState(self._nodes.read_entry(self._status), offset_ns)

    def _first(self, names: tuple[str, ...]) -> str | None:
        return next((name for name in names if self._nodes.available(name)), None)

    def _required(self, names: tuple[str, ...]) -> str:
        name = self._first(names)
        if name is None:
            raise UnsupportedCameraError(
                f"camera {self._nodes.serial}: it has no {' or '.join(names)}, and so no clock that PTP synchronises: "
                "choose another trigger.mode"
            )
        return name
