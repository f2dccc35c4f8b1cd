"""The courses of the odometry judge: short drives through rooms with natural texture, at three speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from evaluation.committed import REPORT_ROOM, ROOMS, TUNING_ROOM
from evaluation.experiments.worth.pictures import digest, picture, stills
from evaluation.odometry.lap import illumination, lap
from evaluation.scenes.scenarios import RATE_HZ, Course, no_turn, steady
from evaluation.scenes.stills import PAINTERS
from evaluation.scenes.views import CAMERA, Feature, natural_room
from evaluation.stage.rendering import Stage
from fake_camera.world.render.renderer import Renderer, Surface
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.simulation import RoomView

Kind = Literal["plain", "dim", "uneven", "window", "lamps", "tunnel"]

# Light on the walls where the drive begins, least and most.
LUX: dict[Kind, tuple[float, float]] = {
    "plain": (10.0, 2000.0),
    "dim": (1.0, 8.0),
    "uneven": (1.0, 60.0),
    "window": (2.0, 100.0),
    "lamps": (2.0, 200.0),
    "tunnel": (60.0, 2000.0),
}

# The light ahead, as a share of that: a bright side, around lamps, and a dark stretch.
THERE: dict[Kind, float] = {"uneven": 30.0, "lamps": 5.0, "tunnel": 1 / 60}
# What is special lies so far to the left of the first view: it comes into view within the drive, even a slow one.
AHEAD_RAD: dict[Kind, float] = {"uneven": 1.5, "window": 1.0, "lamps": 1.2, "tunnel": 1.5}
# Of a lap: at most 33, 86 and 143 mm and degrees a second, and 8, 21 and 36 pixels a frame; `medium` is fig12's.
PERIODS_S = {"slow": 40.0, "medium": 15.0, "fast": 9.0}
SOFT_START_S = 1.0  # From rest to full speed
SECONDS = 2.5
# Repeats (noise): on which the best fixed setting is chosen, which policies see, and on which everyone is scored. The
# errors of two all but identical exposures of one drive differ by a third, most of what two policies differ by in a
# room. Two noises halve the variance of that, at the price of five seconds.
CHOICE, SEEN, SCORED = 0, 1, (2, 3)


@dataclass(frozen=True, slots=True)
class Drive:
    """One course, as plain data."""

    pictures: tuple[str, ...]  # on the walls: photographs by their paths below `DATA`, or paintings by `painter:seed`
    seed: int  # of the room and of the heading
    kind: Kind  # of the room
    lux: float  # light on its walls
    speed: str  # one of `PERIODS_S`
    seconds: float = SECONDS  # how long
    sha256: tuple[str, ...] = ()  # of the pictures' files

    @property
    def name(self) -> str:
        """Unique, for people to read."""
        return f"room {self.seed}, {self.lux:g} lux, {self.kind}, {self.speed}"

    @property
    def frames(self) -> int:
        """How many, at 60 a second."""
        return round(self.seconds * RATE_HZ)

    @property
    def path(self) -> CameraPath:
        """Where the cameras go."""
        return replace(lap(self.seed, PERIODS_S[self.speed]), soft_start_s=SOFT_START_S)

    @property
    def bearing_rad(self) -> float:
        """Where that lies which is special, as seen from the middle of the room."""
        return self.path.heading_rad + AHEAD_RAD.get(self.kind, 0.0)

    def stage(self) -> Stage:
        """What the cameras see, with the noise that policies see."""
        renderer = Renderer(self._lit(), CAMERA)
        left, right = (RoomView(renderer, self.path, side) for side in ("left", "right"))
        still = Course(steady(1.0), no_turn, 0)  # the light is baked in
        return Stage({"left": left, "right": right}, still, self.noise_seed(SEEN))

    def noise_seed(self, repeat: int) -> int:
        """Of the noise of a repeat."""
        return 100 * self.seed + repeat

    def plain(self) -> dict[str, Any]:
        """As a job's argument."""
        return {**asdict(self), "pictures": list(self.pictures), "sha256": list(self.sha256)}

    @classmethod
    def of(cls, plain: dict[str, Any]) -> Drive:
        """From a job's argument."""
        return cls(**{**plain, "pictures": tuple(plain["pictures"]), "sha256": tuple(plain["sha256"])})

    def _lit(self) -> list[Surface]:
        feature: Feature = self.kind if self.kind in ("window", "lamps") else "plain"
        room = natural_room([_picture(picture) for picture in self.pictures], self.seed, feature, self.bearing_rad)
        return [replace(one, pattern=one.pattern * self._light(one)) if one.follows_light else one for one in room]

    def _light(self, surface: Surface) -> Any:
        if self.kind not in THERE:
            return np.float32(self.lux)
        return illumination(surface, (self.lux, self.lux * THERE[self.kind]), self.bearing_rad)


def drives(name: str) -> list[Drive]:
    """Those of the tuning or the report set: all kinds at all speeds, each in light from its least to its most."""
    first = {"tuning": TUNING_ROOM, "report": REPORT_ROOM}[name]
    pictures = tuple(stills(name)) or tuple(f"{painter}:{first}" for painter in PAINTERS)
    sha256 = tuple(digest(picture) for picture in pictures)
    kinds, speeds, each = list(LUX), list(PERIODS_S), ROOMS // len(LUX)
    found = []
    for place in range(ROOMS):
        kind, step = kinds[place % len(kinds)], place // len(kinds)
        low, high = LUX[kind]
        lux = float(f"{low * (high / low) ** ((step + 0.5) / each):.2g}")
        found.append(Drive(pictures, first + place, kind, lux, speeds[step % len(speeds)], sha256=sha256))
    return found


def quick(courses: Sequence[Drive]) -> list[Drive]:
    """Half of the first past a window."""
    return [replace(next(drive for drive in courses if drive.kind == "window"), seconds=SECONDS / 2)]


_picture = cache(picture)
