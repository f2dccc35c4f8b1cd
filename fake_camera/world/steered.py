"""A camera on a robot that is simulated elsewhere: orders say how it moves, and how bright the room is."""

from __future__ import annotations

import json
import math
import reprlib
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fake_camera.world.lighting import Change, LightScript

FIRST_LUX = 150.0

HEIGHT_M = 0.7
"""Of the camera above the floor; it looks ahead, and the left one is where the robot is."""

_REMEMBERED = 50
"""Orders; exposures that began before the oldest are long over."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Where the robot is at a time (CLOCK_MONOTONIC), and how it drives on from there."""

    at_ns: int
    x_m: float
    y_m: float
    heading_rad: float
    forward_m_s: float
    turn_rad_s: float

    def pose(self, time_ns: float) -> NDArray[np.float64]:
        """Of the left camera, camera to world, 4x4."""
        past_s = (time_ns - self.at_ns) * 1e-9
        turned_rad = self.turn_rad_s * past_s
        heading_rad, middle_rad = self.heading_rad + turned_rad, self.heading_rad + turned_rad / 2
        way_m = self.forward_m_s * past_s
        x, y = self.x_m + way_m * math.cos(middle_rad), self.y_m + way_m * math.sin(middle_rad)
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return np.array([[sin, 0.0, cos, x], [-cos, 0.0, sin, y], [0.0, -1.0, 0.0, HEIGHT_M], [0.0, 0.0, 0.0, 1.0]])


class Steered:
    """Path and light of a steered camera. Safe to use from any thread.

    Attributes
    ----------
    epoch_ns
        The time 0 of `pose`, `lux` and `mean_lux` on CLOCK_MONOTONIC: that of the wire.
    """

    def __init__(self) -> None:
        self.epoch_ns = 0
        self._turn = threading.Lock()
        self._motions = deque([Motion(0, 0.0, 0.0, 0.0, 0.0, 0.0)], maxlen=_REMEMBERED)
        self._light = LightScript((Change(0.0, FIRST_LUX),))

    def take(self, line: str) -> bool:
        """Take an order: ``{"motion": {...}}`` with the fields of `Motion`, or ``{"light": {"at_ns": n, "lux": x}}``.

        Returns whether it is one of these. ValueError with one sentence when it is, but a wrong one.
        """
        try:
            order = json.loads(line)
        except (ValueError, RecursionError):
            return False
        if not isinstance(order, dict) or not order.keys() & {"motion", "light"}:
            return False
        if len(order) > 1:
            raise ValueError("an order of motion or light has no other key: give motion and light one by one")
        with self._turn:
            if "motion" in order:
                values = _numbers(order["motion"], "motion", [field.name for field in fields(Motion)])
                motion = Motion(int(values.pop("at_ns")), **values)
                if motion.at_ns < self._motions[-1].at_ns:
                    raise ValueError("motion.at_ns must not be before that of the last order")
                self._motions.append(motion)
            else:
                values = _numbers(order["light"], "light", ["at_ns", "lux"])
                change = Change((values["at_ns"] - self.epoch_ns) * 1e-9, values["lux"])
                self._light = LightScript((*self._light.changes, change))
        return True

    def pose(self, time_s: float) -> NDArray[np.float64]:
        """Of the left camera, camera to world, 4x4, by the last order before a time."""
        time_ns = self.epoch_ns + 1e9 * time_s
        with self._turn:
            motions = list(self._motions)
        return next((one for one in reversed(motions) if one.at_ns <= time_ns), motions[0]).pose(time_ns)

    def lux(self, time_s: float) -> float:
        """Light at a time."""
        return self._light.lux(time_s)

    def mean_lux(self, start_s: float, exposure_s: float) -> float:
        """Mean light over an exposure."""
        return self._light.mean_lux(start_s, exposure_s)


def _numbers(value: object, where: str, keys: list[str]) -> dict[str, float]:
    if not isinstance(value, Mapping) or set(value) != set(keys):
        raise ValueError(f"{where} must be an object with the keys {', '.join(keys)}")
    for key, number in value.items():
        if isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) < 1e18:
            raise ValueError(f"{where}.{key} must be a number, not {reprlib.repr(number)}")
    return dict(value)
