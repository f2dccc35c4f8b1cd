"""For consumers of the daemon's frames: ``for pair in StereoClient("rig"): ...``. Needs no camera and no Aravis."""

from autoexpose_daemon.client.pairs import NormalisedPair, ReceivedPair, alike
from autoexpose_daemon.client.stereo_client import StereoClient
from autoexpose_daemon.control.inputs import count_by_cell

__all__ = ["NormalisedPair", "ReceivedPair", "StereoClient", "alike", "count_by_cell"]
