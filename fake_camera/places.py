"""Where the cameras of a rig are: a stereo pair, or pairs around a robot that look to all four sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Side = Literal["left", "right"]

SUN_STOPS = 3.0
"""How much more light there is on what the pair at the rear sees."""


@dataclass(frozen=True, slots=True)
class Place:
    """Of one camera: its side of its stereo pair, how far the pair is turned right, and the sun on what it sees."""

    side: Side
    yaw_deg: float = 0.0
    sunlit_stops: float = 0.0


_PAIR = {"left": Place("left"), "right": Place("right")}
_AROUND = {
    f"{view}_{place.side}": Place(place.side, yaw_deg, sunlit_stops)
    for view, yaw_deg, sunlit_stops in (
        ("front", 0.0, 0.0),
        ("rear", 180.0, SUN_STOPS),
        ("port", -90.0, 0.0),
        ("starboard", 90.0, 0.0),
    )
    for place in _PAIR.values()
}
PLACES = _PAIR | _AROUND
"""By name."""

MOST_CAMERAS = len(_AROUND)


def names_of_rig(cameras: int) -> list[str]:
    """The places of a rig of 1 to 8 cameras; ValueError for any other number."""
    if not 1 <= cameras <= MOST_CAMERAS:
        raise ValueError(f"a rig of {cameras} cameras: give 1 to {MOST_CAMERAS}")
    return [*(_PAIR if cameras <= len(_PAIR) else _AROUND)][:cameras]
