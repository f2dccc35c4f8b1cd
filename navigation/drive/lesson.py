"""Teaching a path: local maps at even distances, the speeds between them, and what a drive saw of the light."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.light_ahead import MOST_STOPS
from autoexpose_daemon.control.registration import LightRegistration
from autoexpose_daemon.control.view import View
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side
from imaging.response import ResponseFunction
from navigation.drive.steering import Velocity
from navigation.maps.path import LIGHT_EVERY_M, LightRow
from navigation.store import TaughtPlace
from navigation.views.detectors import AdaptiveFinder

SIDE: Final[Side] = "left"

BLIND_SHARE: Final = 0.8
"""With this share of a frame's pixels black or saturated, changes of the light do not show ..."""

MOST_WAITING: Final = 120
"""... and its place waits for that, but no more than so many."""


class LightTrail:
    """Collects how the light changed on a drive, and the exposure levels of its frames."""

    def __init__(self) -> None:
        self._rows: list[LightRow] = []
        self._waiting: list[LightRow] = []
        self._next_m = self._risen = 0.0
        self._seen_by: tuple[View, LightRegistration] | None = None

    def see(self, distance_m: float, frame: Frame, response: ResponseFunction) -> None:
        """The left frame taken after this distance along the path."""
        if distance_m < self._next_m:
            return
        self._next_m = distance_m + LIGHT_EVERY_M
        view, registration = self._seen_by = self._seen_by or (View(response), LightRegistration({SIDE: response}))
        look = view.look(SIDE, frame)
        light = registration.change(look, frame.setting.level)
        change = light.stops if light else 0.0
        self._risen += change
        here = distance_m, frame.setting.level, self._risen
        if sum(view.shares.measure(look.image, look.weights)) >= BLIND_SHARE:
            self._waiting.append(here)
            self._add(self._waiting[:-MOST_WAITING])
            self._waiting = self._waiting[-MOST_WAITING:]
            return
        # What only shows now had changed when nothing was seen.
        later = [(place_m, level, risen + change) for place_m, level, risen in self._waiting[1:]]
        self._add([*self._waiting[:1], *later, here])
        self._waiting = []

    def new_rows(self, *, ended: bool = False) -> list[LightRow]:
        """What was found since this was last asked; the newest places wait if nothing shows there, or for the end."""
        if ended:
            self._add(self._waiting)
            self._waiting = []
        rows, self._rows = self._rows, []
        return rows

    def _add(self, rows: list[LightRow]) -> None:
        self._rows += [row for row in rows if abs(row[1]) <= MOST_STOPS]


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
