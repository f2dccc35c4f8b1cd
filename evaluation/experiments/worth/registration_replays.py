"""The courses of the registration judge: paths through parks, taught once and replayed in another light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

from evaluation.arrays import Floats
from evaluation.committed import REPORT_PARK, TUNING_PARK
from evaluation.experiments.teach.judge import TILTS, WITHIN_PX
from evaluation.experiments.teach.park import REPLAYS, TEACHING, Daylight, park
from evaluation.experiments.teach.path import MAPS as PATH_MAPS
from evaluation.experiments.teach.path import TaughtPath
from evaluation.experiments.teach.replay import Truth, frames, image_of
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import SimulatedCamera
from fake_camera.world.render.renderer import Renderer, Surface
from navigation.views.registration import Vote

MAPS = 10  # Of the 80 along a path, with eight images each
# Repeats (noise) on which bounds are chosen, and on which they are scored; policies run on the first of these.
CHOICE, SCORING = 0, (1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One image of a replay."""

    index: int  # of the map that it is registered with
    # pose, lux: where it is taken (camera to world, 4x4), and in which light.
    pose: Floats
    lux: float
    shift: float  # the true one, pixels; NaN where nothing upright is in both views

    def found(self, vote: Vote) -> bool:
        """Whether a registration is right, within 5 pixels; a NaN never is."""
        return vote.shift_px is not None and abs(vote.shift_px - self.shift) <= WITHIN_PX


@dataclass(frozen=True, slots=True)
class Replay:
    """One course, as plain data."""

    seed: int  # of park and path
    light: str  # of the replay, one of `REPLAYS`
    sky: str  # where it is in the view, one of `TILTS`
    # first, maps: the first of its maps, and how many. Where registration is hard differs along a path.
    first: int
    maps: int = MAPS

    @property
    def name(self) -> str:
        """Unique, for people to read."""
        return f"park {self.seed} from map {self.first}, {self.light}, sky {self.sky}"

    @property
    def path(self) -> TaughtPath:
        """Where the robot goes."""
        return TaughtPath(self.seed, TILTS[self.sky])

    def renderers(self) -> tuple[Renderer, Renderer]:
        """The park when the path is taught, and when it is replayed."""
        before, after = (Renderer(_built(self.seed, day), CAMERA) for day in (TEACHING, REPLAYS[self.light]))
        return before, after

    def looks(self) -> list[Look]:
        """The images that are registered."""
        truth, path = Truth(_built(self.seed, TEACHING)), self.path
        return [
            Look(index, pose, lux, truth.shift(path.taught(self.first + index), pose))
            for frame, pose, lux in frames(path, self.light, self.maps, self.first)
            if (index := image_of(frame)) is not None
        ]

    def camera(self, drive: int, repeat: int) -> SimulatedCamera:
        """The camera when teaching (0) or replaying (1); the repeat decides the noise."""
        seed = 2 * self.seed + drive
        return SimulatedCamera(seed, 10_000 * repeat + seed)

    def plain(self) -> dict[str, Any]:
        """As a job's argument."""
        return asdict(self)


@lru_cache(maxsize=2)
def _built(seed: int, daylight: Daylight) -> list[Surface]:
    """A park; it takes seconds to build."""
    return park(seed, daylight)


_UPPER, _BEYOND, _HARDLY = TILTS


def tuning() -> list[Replay]:
    """For development."""
    return _around(TUNING_PARK, [("clear", _UPPER), ("clear", _BEYOND), ("overcast", _UPPER), ("sunset", _BEYOND)], 60)


def report() -> list[Replay]:
    """What counts: other parks."""
    clear = [("clear", _UPPER), ("clear", _BEYOND), ("clear", _HARDLY)]
    return _around(
        REPORT_PARK, [*clear, *clear[::2], ("overcast", _UPPER), ("overcast", _BEYOND), ("sunset", _UPPER)], 0
    )


def _around(seed: int, cases: Sequence[tuple[str, str]], first: int) -> list[Replay]:
    """Each case in a park of its own, with stretches all around the path."""
    return [
        Replay(seed + place, light, sky, (first + 30 * place) % PATH_MAPS) for place, (light, sky) in enumerate(cases)
    ]


SETS = {"tuning": tuning, "report": report}  # The sets by name


def quick(replays: Sequence[Replay]) -> list[Replay]:
    """Three maps of the first."""
    return [replace(replays[0], maps=3)]
