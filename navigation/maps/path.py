"""What is remembered along a path besides features: speeds, and the light that a drive foretells to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.inputs import MOST_STOPS, LightSeries
from autoexpose_daemon.control.registration import LightRegistration
from autoexpose_daemon.control.view import View
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame
from imaging.response import ResponseFunction
from navigation.views.features import AdaptiveFinder, Features


class Velocity(NamedTuple):
    """How a robot drives: forward (m/s), and turns, positive to the left (rad/s)."""

    forward_m_s: float
    turn_rad_s: float


STANDSTILL: Final = Velocity(0.0, 0.0)

STEP_S: Final = 0.02
BEHIND_S, AHEAD_S = 2.2, 2.0
"""Control uses a second back and half a second ahead, and on either side a margin for where the robot may really be."""

LIGHT_EVERY_M: Final = 0.01
"""From one remembered place to the next."""

SPREAD_M: Final = 0.05
"""Standard deviation of how far along the path a robot is from where it believes it is."""

SLOWEST_M_S: Final = 0.05
"""Below this speed, the light changes by itself sooner than through driving."""


LightRow = tuple[float, float, float]
"""How far along the path (m), the level of the frame there, and by how much the light had risen (stops)."""


@dataclass(frozen=True, slots=True, eq=False)
class LightMemory:
    """The light of a drive, as in `LightAhead`, by distance along the path (m, never falling); float64, (n,), n > 0."""

    distances_m: NDArray[np.float64]
    levels: NDArray[np.float64]
    risen: NDArray[np.float64]

    @classmethod
    def of(cls, rows: Sequence[LightRow]) -> LightMemory:
        """The memory of the rows of a drive, at least one."""
        return cls(*np.array(rows, np.float64).T)

    def series(self, distance_m: float, speed_m_s: float) -> LightSeries | None:
        """The light around a place, at a speed; None for a robot that hardly moves."""
        if speed_m_s < SLOWEST_M_S:
            return None
        behind, ahead = round(BEHIND_S / STEP_S), round(AHEAD_S / STEP_S)
        there_m = distance_m + np.arange(-behind, ahead + 1) * STEP_S * speed_m_s
        levels, risen = (np.interp(there_m, self.distances_m, stops) for stops in (self.levels, self.risen))
        risen -= np.rint(risen[behind])  # errors of registration add up over a drive, and only differences count
        return LightSeries(levels, risen, behind, STEP_S, SPREAD_M / speed_m_s)


@dataclass(frozen=True, slots=True, eq=False)
class TaughtPath:
    """The speeds that a path was taught with, float64, (n,): each holds from its distance from the start on.

    Distances ascend, and the last one is the length of the path; speeds are positive forward and to the left.
    """

    distances_m: NDArray[np.float64]
    forward_m_s: NDArray[np.float64]
    turn_rad_s: NDArray[np.float64]

    @property
    def length_m(self) -> float:
        """How far it is to the end."""
        return float(self.distances_m[-1]) if len(self.distances_m) else 0.0

    def at(self, distance_m: float) -> Velocity:
        """The speeds at a distance from the start.

        Where the robot stood still while it was taught, these are the speeds at which it then drove on. At the end of
        the path, where it rolled on after it was told to stop, they are those before: nothing would end the standstill.
        """
        row = max(int(np.searchsorted(self.distances_m, distance_m, "right")) - 1, 0)
        driving = np.flatnonzero(self.forward_m_s)
        if len(driving):
            row = int(driving[min(int(np.searchsorted(driving, row)), len(driving) - 1)])
        return Velocity(float(self.forward_m_s[row]), float(self.turn_rad_s[row]))


@dataclass(frozen=True, slots=True, eq=False)
class TaughtPlace:
    """A local map as taught: distance along the path (m), its JPEG picture, and the picture's setting and features."""

    distance_m: float
    jpeg: bytes
    setting: ExposureSetting
    features: Features


SIDE: Final[CameraName] = "left"

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
    """Decides what to remember of a drive; its `finder` sees every frame, so that its threshold follows the scene."""

    def __init__(self, finder: AdaptiveFinder) -> None:
        self._finder = finder
        self._places = 0
        self.velocity: Velocity | None = None
        self._speeds: list[tuple[float, float, float]] = []

    def drive(self, velocity: Velocity, distance_m: float) -> None:
        """Note that the robot was commanded to drive like this, after `distance_m` from the start."""
        if velocity != self.velocity:
            self.velocity = velocity
            self._speeds.append((distance_m, velocity.forward_m_s, velocity.turn_rad_s))

    def begin(self) -> None:
        """The path begins here, with the robot perhaps on its way: what came before does not belong to it."""
        self._speeds = [] if self.velocity is None else [(0.0, *self.velocity)]

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
