"""Teaching a path: local maps at even distances, and the speeds between them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.navigation.drive.motion import Velocity
from autoexpose_daemon.navigation.store import TaughtPlace
from autoexpose_daemon.navigation.views.detectors import AdaptiveFinder
from imaging.exposure import ExposureSetting

EVERY_M = 0.2
"""From one local map to the next, as in the authors' README."""

JPEG_QUALITY = 90


class Lesson:
    """Decides what to remember of a drive.

    Parameters
    ----------
    finder
        Finds the features of local maps; it sees every frame, so that its threshold follows the scene.
    """

    def __init__(self, finder: AdaptiveFinder) -> None:
        self._finder = finder
        self._places = 0
        self._velocity: Velocity | None = None
        self._speeds: list[tuple[float, float, float]] = []

    def drive(self, velocity: Velocity, distance_m: float) -> None:
        """Note that the robot was commanded to drive like this, after `distance_m` from the start."""
        if velocity != self._velocity:
            self._velocity = velocity
            self._speeds.append((distance_m, velocity.forward_m_s, velocity.turn_rad_s))

    def begin(self) -> None:
        """The path begins here, with the robot perhaps on its way: what came before does not belong to it."""
        self._speeds = [] if self._velocity is None else [(0.0, *self._velocity)]

    @property
    def driven(self) -> bool:
        """Whether a velocity has been heard at all."""
        return self._velocity is not None

    def look(self, image: NDArray[np.uint8], setting: ExposureSetting, distance_m: float) -> TaughtPlace | None:
        """What to remember of a frame, uint8, (height, width); None if the last local map is near."""
        features = self._finder.find(image)
        if distance_m < EVERY_M * self._places:
            return None
        self._places = int(distance_m / EVERY_M) + 1
        _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        return TaughtPlace(distance_m, jpeg.tobytes(), setting, features)

    def new_speeds(self) -> list[tuple[float, float, float]]:
        """Distance (m), forward (m/s) and turn (rad/s) of each change since this was last asked."""
        speeds, self._speeds = self._speeds, []
        return speeds
