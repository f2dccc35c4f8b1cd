"""What rosbag2's storage for MCAP looks for in a file besides messages."""

from __future__ import annotations

from typing import Final

from autoexpose_daemon.messages.keys import OfferedQos

OFFERED_QOS: Final = "offered_qos_profiles"
"""Key in a channel's metadata: YAML that says how the topic was offered, so that `ros2 bag play` offers it that way."""

METADATA: Final = "rosbag2"
EARLY_YAML: Final = {"serialized_metadata": ""}
"""A metadata record of this name and content: the policies in the YAML are numbers.

Up to Humble, rosbag2 reads nothing but numbers. Since Jazzy it takes them for names unless the file says that it is
older, and this is how: by a record without the metadata that rosbag2 has written into it since.
"""

# The numbers are those of rmw/types.h.
_KEEP_LAST, _AUTOMATIC = 1, 1
_RELIABLE, _BEST_EFFORT = 1, 2
_TRANSIENT_LOCAL, _VOLATILE = 1, 2

_FOREVER: Final = "{sec: 9223372036, nsec: 854775807}"
"""RMW_DURATION_INFINITE."""


def profiles(qos: OfferedQos) -> str:
    """The value of `OFFERED_QOS` for a topic with one publisher."""
    policies = {
        "history": _KEEP_LAST,
        "depth": qos.depth,
        "reliability": _RELIABLE if qos.reliable else _BEST_EFFORT,
        "durability": _TRANSIENT_LOCAL if qos.latched else _VOLATILE,
        "deadline": _FOREVER,
        "lifespan": _FOREVER,
        "liveliness": _AUTOMATIC,
        "liveliness_lease_duration": _FOREVER,
        "avoid_ros_namespace_conventions": "false",
    }
    return "- " + "\n  ".join(f"{policy}: {value}" for policy, value in policies.items())
