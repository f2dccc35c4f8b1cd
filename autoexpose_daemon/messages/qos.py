"""How topics are offered in ROS 2: quality of service, whatever middleware or file carries them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class OfferedQos:
    """What a publisher offers to its subscribers.

    Attributes
    ----------
    reliable
        Lost messages are sent again; otherwise best effort.
    depth
        How many of the last messages are kept to be sent.
    latched
        Those are also sent to subscribers that join later ("transient local"); otherwise volatile.
    """

    reliable: bool
    depth: int
    latched: bool = False


SENSOR_DATA: Final = OfferedQos(reliable=False, depth=5)
"""For frames and what belongs to a frame, as camera drivers offer them."""

DEFAULT: Final = OfferedQos(reliable=True, depth=10)

LATCHED: Final = OfferedQos(reliable=True, depth=1, latched=True)
"""For what is sent once and holds until it is sent again."""
