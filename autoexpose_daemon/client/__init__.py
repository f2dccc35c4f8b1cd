"""For consumers of the daemon's frames: ``for pair in StereoClient("rig"): ...``. Needs no camera and no Aravis.

What is named here is imported when it is first used: `MessageClient` needs zenoh alone, the rest more.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from autoexpose_daemon.client.message_client import MessageClient
    from autoexpose_daemon.client.received import NormalisedPair, NormalisedSet, ReceivedPair, ReceivedSet, alike
    from autoexpose_daemon.client.rig_client import RigClient, StereoClient
    from autoexpose_daemon.control.inputs import LightSeries, count_by_cell
    from imaging.errors import AutoexposeError

__all__ = [
    "AutoexposeError", "LightSeries", "MessageClient", "NormalisedPair", "NormalisedSet", "ReceivedPair", "ReceivedSet",
    "RigClient", "StereoClient", "alike", "count_by_cell",
]  # fmt: skip

_HOMES = {
    "AutoexposeError": "imaging.errors",
    "LightSeries": "autoexpose_daemon.control.inputs",
    "MessageClient": "autoexpose_daemon.client.message_client",
    "RigClient": "autoexpose_daemon.client.rig_client",
    "StereoClient": "autoexpose_daemon.client.rig_client",
    "count_by_cell": "autoexpose_daemon.control.inputs",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(_HOMES.get(name, "autoexpose_daemon.client.received")), name)
