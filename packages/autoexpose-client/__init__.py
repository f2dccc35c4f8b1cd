"""Frames of an autoexpose daemon, with their exposures: ``for pair in StereoClient("rig"): ...``.

The same as `autoexpose_daemon.client`, without the daemon.
"""

from autoexpose_daemon.client import *  # noqa: F403
from autoexpose_daemon.client import __all__ as __all__
