"""The courses of the odometry judge: drives through rooms with natural texture, at three speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, Literal

from evaluation.experiments.worth.pictures import digest, picture, stills
from evaluation.odometry.lap import illumination, lap
from evaluation.scenes.natural_rooms import Feature, natural_room
from evaluation.scenes.scenarios import RATE_HZ, Course, no_turn, steady
from evaluation.scenes.stills import PAINTERS
from evaluation.scenes.views import CAMERA
from evaluation.stage.rendering import Stage
from fake_camera.world.render.renderer import Renderer, Surface
from fake_camera.world.simulation import RoomView

Surroundings = Literal["plain", "window", "lamps", "tunnel"]
"""Even light; with a window to daylight; with lamps, around which it is brighter; with a dark stretch."""

PERIODS_S = {"slow": 40.0, "medium": 15.0, "fast": 9.0}
"""Of a lap: at most 33, 86 and 143 mm and degrees a second, and 8, 21 and 36 pixels a frame; `medium` is fig12's."""

AHEAD_RAD = 1.0
"""The window, the lamps or the dark are this far to the left of the first view; slow drives get there within 4 s."""

TUNNEL_FACTOR, LAMPS_FACTOR = 1 / 60, 5.0
"""Of the light in the dark stretch (6 stops), and around the lamps."""

SECONDS = 4.0

CHOICE, SCORING = 0, (1, 2, 3, 4)
"""Repeats (noise) on which bounds are chosen, and on which everyone is scored; policies see the first of these."""


@dataclass(frozen=True, slots=True)
class Drive:
    """One course, as plain data.

    Attributes
    ----------
    pictures
        On the walls: photographs by their paths below `DATA`, or paintings by `painter:seed`.
    seed
        Of the room and of the heading.
    lux
        Light on its walls.
    surroundings
        What else there is.
    speed
        One of `PERIODS_S`.
    seconds
        How long.
    sha256
        Of the pictures' files.
    """

    pictures: tuple[str, ...]
    seed: int
    lux: float
    surroundings: Surroundings
    speed: str
    seconds: float = SECONDS
    sha256: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Unique, for people to read."""
        return f"room {self.seed}, {self.lux:g} lux, {self.surroundings}, {self.speed}"

    @property
    def frames(self) -> int:
        """How many, at 60 a second."""
        return round(self.seconds * RATE_HZ)

    def stage(self, repeat: int) -> Stage:
        """What the cameras see; the number of the repeat decides the noise."""
        path = lap(self.seed, PERIODS_S[self.speed])
        bearing_rad = path.heading_rad + AHEAD_RAD
        renderer = Renderer(self._lit(bearing_rad), CAMERA)
        left, right = (RoomView(renderer, path, side) for side in ("left", "right"))
        still = Course(steady(1.0), no_turn, 0)  # the light is baked in
        return Stage({"left": left, "right": right}, still, self.noise_seed(repeat))

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

    def _lit(self, bearing_rad: float) -> list[Surface]:
        feature: Feature = "plain" if self.surroundings == "tunnel" else self.surroundings
        there = self.lux * {"tunnel": TUNNEL_FACTOR, "lamps": LAMPS_FACTOR}.get(self.surroundings, 1.0)
        room = natural_room([_picture(picture) for picture in self.pictures], self.seed, feature, bearing_rad)
        return [
            replace(one, pattern=one.pattern * illumination(one, (self.lux, there), bearing_rad))
            if one.follows_light else one
            for one in room
        ]  # fmt: skip


def tuning() -> list[Drive]:
    """For development."""
    pictures = _pictures("tuning", first_painting=11)
    return [
        _drive(pictures, 1, 20.0, "plain", "medium"),
        _drive(pictures, 2, 5.0, "window", "slow"),
        _drive(pictures, 3, 200.0, "tunnel", "fast"),
        _drive(pictures, 4, 10.0, "lamps", "medium"),
    ]


def report() -> list[Drive]:
    """What counts: other pictures, other rooms."""
    pictures = _pictures("report", first_painting=2011)
    return [
        _drive(pictures, 101, 2.0, "plain", "medium"),
        _drive(pictures, 102, 6.0, "window", "slow"),
        _drive(pictures, 103, 15.0, "lamps", "fast"),
        _drive(pictures, 104, 50.0, "window", "medium"),
        _drive(pictures, 105, 300.0, "tunnel", "slow"),
        _drive(pictures, 106, 2000.0, "plain", "fast"),
    ]


SETS = {"tuning": tuning, "report": report}
"""The sets by name. Rooms of the report have seeds from 100 on; nothing is chosen by them."""


def quick(drives: Sequence[Drive]) -> list[Drive]:
    """Half of the first drive."""
    return [replace(drives[0], seconds=SECONDS / 2)]


def _drive(pictures: tuple[str, ...], seed: int, lux: float, surroundings: Surroundings, speed: str) -> Drive:
    return Drive(pictures, seed, lux, surroundings, speed, sha256=tuple(digest(picture) for picture in pictures))


def _pictures(name: str, first_painting: int) -> tuple[str, ...]:
    """The stills of a set; paintings where there are no data."""
    return tuple(stills(name)) or tuple(f"{painter}:{first_painting + place}" for place, painter in enumerate(PAINTERS))


_picture = cache(picture)
