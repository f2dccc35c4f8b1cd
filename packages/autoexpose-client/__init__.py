"""Frames of an autoexpose daemon, with their exposures: ``for pair in StereoClient("rig"): ...``.

The same as `autoexpose_daemon.client`, without the daemon.
"""

from autoexpose_daemon.client import NormalisedPair, ReceivedPair, StereoClient, alike, count_by_cell

__all__ = ["NormalisedPair", "ReceivedPair", "StereoClient", "alike", "count_by_cell"]
