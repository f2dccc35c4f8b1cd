"""Frames of an autoexpose daemon, with their exposures: ``for pair in StereoClient("rig"): ...``.

The same as `autoexpose_daemon.client`, without the daemon.
"""

from typing import TYPE_CHECKING, Any

from autoexpose_daemon import client
from autoexpose_daemon.client import __all__ as __all__

if TYPE_CHECKING:
    from autoexpose_daemon.client import *  # noqa: F403


def __getattr__(name: str) -> Any:
    return getattr(client, name)
