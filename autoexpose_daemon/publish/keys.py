"""The keys under which a rig is found in zenoh."""

from __future__ import annotations

import re

from drivers.frames import Side

LOOPBACK = "tcp/127.0.0.1:7448"
"""Where a daemon listens unless configured otherwise; next to 7447, which is that of zenoh routers."""

RIG_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""What zenoh takes in a key and ROS 2 in the name of a coordinate frame."""


def frame_key(rig: str, side: Side, topic: str) -> str:
    """Where the messages of a camera go; `topic` is one of `image`, `camera_info`, `exposure`."""
    return f"autoexpose/{rig}/{side}/{topic}"


def topic_of_both(rig: str, topic: str) -> str:
    """A key expression for one topic of both cameras."""
    return f"autoexpose/{rig}/*/{topic}"


def consumer_key(rig: str, name: str) -> str:
    """Where a consumer reports its losses; `*` for all of them."""
    return f"autoexpose/{rig}/consumers/{name}"


def last_but(key: str, parts: int) -> str:
    """The part of a key that `parts` others follow."""
    return key.split("/")[-1 - parts]
