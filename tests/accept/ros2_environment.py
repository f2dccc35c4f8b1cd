"""The environment in which programs of the ROS 2 in `build/` run, by themselves on this machine."""

from __future__ import annotations

import os
from pathlib import Path


def ros_environment(ros: Path, domain: int) -> dict[str, str]:
    """That of an installation, in a domain; nothing else of this process but its home and programs."""
    return {
        "HOME": os.environ.get("HOME", "/"),
        "PATH": f"{ros}/bin:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(ros),
        "CMAKE_PREFIX_PATH": str(ros),
        "LD_LIBRARY_PATH": f"{ros}/lib",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
