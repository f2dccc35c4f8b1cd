"""For consumers of the daemon's frames: ``for pair in StereoClient("rig"): ...``. Needs no camera and no Aravis."""

from autoexpose_daemon.client.received import NormalisedPair, NormalisedSet, ReceivedPair, ReceivedSet, alike
from autoexpose_daemon.client.rig_client import RigClient, StereoClient
from autoexpose_daemon.control.inputs import count_by_cell

__all__ = [
    "NormalisedPair", "NormalisedSet", "ReceivedPair", "ReceivedSet", "RigClient", "StereoClient", "alike",
    "count_by_cell",
]  # fmt: skip
