"""For consumers of the daemon's frames: ``for pair in StereoClient("rig"): ...``. Needs no camera and no Aravis."""

from autoexpose_daemon.client.pairs import NormalisedPair, ReceivedPair, alike
from autoexpose_daemon.client.stereo_client import StereoClient

__all__ = ["NormalisedPair", "ReceivedPair", "StereoClient", "alike"]
