"""A simulated robot repeats a taught lap of the park by registrations alone, in every light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arrays import Flags, Floats
from evaluation.experiments.navigation.seasons import Night, ParkScene
from evaluation.experiments.teach.park import REPLAYS, TEACHING, Daylight, ParkPath
from evaluation.experiments.teach.replay import ExposingRobot
from evaluation.jobs.job import Plain
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import Entrant, Radiance, SimulatedCamera
from navigation.drive.repetition import Repetition, Stop
from navigation.maps.adaptation import LocalMap
from navigation.maps.path import Lesson, Velocity
from navigation.maps.path import TaughtPath as TaughtSpeeds
from navigation.store import MapInfo, Place
from navigation.views.features import FINDERS

SPEED_M_S, PERIOD_S = 0.4, 0.1  # The robot looks and steers ten times a second, every 4 cm
# Of its odometry and of its turns: 2 % of the distance, and a degree a metre.
SCALE_ERROR, DRIFT_RAD_PER_M = 0.02, math.radians(1.0)
STEP_NS = round(PERIOD_S * 1e9)
SWITCHED = 1 / 100  # The light of the middle third of a lap, where it is switched off and on again


@dataclass(frozen=True, slots=True)
class Switched(Daylight):
    """Light that goes out for the middle third of the drive."""

    def lux(self, progress: float) -> float:
        """At a share (0..1) of the drive."""
        return Daylight.lux(self, progress) * (SWITCHED if 1 / 3 <= progress < 2 / 3 else 1.0)


LIGHTS: MappingProxyType[str, Daylight] = MappingProxyType({
    "as taught": TEACHING,
    "low sun": REPLAYS["clear"],
    "overcast": REPLAYS["overcast"],
    "after sunset": REPLAYS["sunset"],
    "switched": Switched(195.0, 20.0, 0.0, 0.0, 0.0, first_lux=500.0, last_lux=500.0, day=4),
    "lamp at night": Night(0.0, 90.0, 0.0, 0.0, 0.0, first_lux=0.0, last_lux=0.0, day=5),
})  # fmt: skip
"""In which the taught lap is repeated."""


@dataclass(frozen=True, slots=True, eq=False)
class DrivenLap:
    """How one lap went."""

    aside_m: Floats  # distance from the taught path at each look, float64, (n,)
    registered: Flags  # whether each look was registered, bool, (n,)
    stop: Stop | None  # why it ended

    @property
    def completed(self) -> bool:
        """Whether the robot came to the end of the path."""
        return self.stop is Stop.END


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """A path through a park, and what a robot with an exposure policy has learnt of it."""

    # path, seed: the truth.
    path: ParkPath
    seed: int
    policy: str  # of the exposure
    # speeds, places: the map.
    speeds: TaughtSpeeds
    places: list[Place]


class Wanderer:
    """A robot that drives as it is told, with errors, and does not know where it is. `place`, `heading_rad`: where it
    is in truth. `driven_m`: what its odometry says it has driven."""

    def __init__(self, place: Floats, heading_rad: float, seed: int) -> None:
        random = np.random.default_rng([seed, 91])
        self.place, self.heading_rad, self.driven_m = place.copy(), heading_rad, 0.0
        self._scale = 1.0 + SCALE_ERROR * random.choice([-1.0, 1.0])
        self._drift_rad_per_m = DRIFT_RAD_PER_M * random.choice([-1.0, 1.0])

    def drive(self, velocity: Velocity) -> None:
        """For one period."""
        way_m = velocity.forward_m_s * PERIOD_S
        half_rad = velocity.turn_rad_s * PERIOD_S / 2
        middle = self.heading_rad + half_rad
        self.place += way_m * np.array([math.cos(middle), math.sin(middle)])
        self.heading_rad += 2 * half_rad + self._drift_rad_per_m * way_m
        self.driven_m += way_m * self._scale


def taught(path: ParkPath, seed: int, policy: str, length_m: float) -> Taught:
    """The map of a lap that was driven exactly along the path."""
    scene, camera = _scene(seed, "as taught"), SimulatedCamera(2 * seed, 2 * seed)
    lesson = Lesson(FINDERS["fast-orb"]())
    places: list[Place] = []
    robot: ExposingRobot | None = None
    for step in range(math.ceil(length_m / (SPEED_M_S * PERIOD_S)) + 1):
        distance_m = step * SPEED_M_S * PERIOD_S
        place, heading_rad = path.ground(distance_m)
        turn_rad = math.remainder(path.ground(distance_m + SPEED_M_S * PERIOD_S)[1] - heading_rad, 2 * math.pi)
        lesson.drive(Velocity(SPEED_M_S, turn_rad / PERIOD_S), distance_m)
        radiance = scene.radiance(path.seen_from(place, heading_rad))
        robot = robot or ExposingRobot(camera, radiance, [_entrant(policy)], 1.0 / PERIOD_S)
        image = robot.step(radiance)[policy]
        found = lesson.look(image, robot.loops[policy].settings[-1], distance_m)
        if found is not None:
            local_map = LocalMap.taught(found.features)
            places.append(Place(len(places), found.distance_m, found.setting, len(local_map), local_map))
    speeds = np.array([*lesson.new_speeds(), (length_m, 0.0, 0.0)]).T
    return Taught(path, seed, policy, TaughtSpeeds(*speeds), places)


class LapRepeater:
    """A robot that repeats a taught path in another light; laps follow each other from where the last one ended.
    `light`: one of `LIGHTS`. `aside_m`, `turned_rad`: where it starts beside the path, positive to the left."""

    def __init__(self, lesson: Taught, light: str, policy: str, *, aside_m: float, turned_rad: float) -> None:
        self._lesson, self._policy = lesson, policy
        self._scene = _scene(lesson.seed, light)
        start, heading_rad = lesson.path.ground(0.0)
        left = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
        self._wanderer = Wanderer(start + aside_m * left, heading_rad + turned_rad, lesson.seed)
        camera = SimulatedCamera(2 * lesson.seed + 1, 2 * lesson.seed + 1)
        self._robot = ExposingRobot(camera, self._view(0.0), [_entrant(policy)], 1.0 / PERIOD_S)

    def lap(self) -> DrivenLap:
        """Once along the path."""
        path, wanderer = self._lesson.path, self._wanderer
        info = MapInfo(CAMERA.width, CAMERA.height, CAMERA.focal_px, "fast-orb", self._lesson.policy)
        repetition = Repetition(info, self._lesson.speeds, self._lesson.places, FINDERS["fast-orb"](), "static")
        start_m, now_ns = wanderer.driven_m, 0
        asides_m: list[float] = []
        registered: list[bool] = []
        stop: Stop | None = None
        while stop is None:
            distance_m = wanderer.driven_m - start_m
            repetition.look(self._robot.step(self._view(distance_m))[self._policy], distance_m, now_ns)
            velocity, stop = repetition.velocity(distance_m, now_ns, now_ns)
            asides_m.append(path.aside_m(wanderer.place))
            registered.append(repetition.view is not None and repetition.view.shift_px is not None)
            wanderer.drive(velocity)
            now_ns += STEP_NS
        return DrivenLap(np.array(asides_m), np.array(registered), stop)

    def _view(self, distance_m: float) -> Radiance:
        pose = self._lesson.path.seen_from(self._wanderer.place, self._wanderer.heading_rad)
        return self._scene.radiance(pose, min(distance_m / self._lesson.path.length_m, 1.0))


@lru_cache(maxsize=1)
def _scene(seed: int, light: str) -> ParkScene:
    return ParkScene(seed, LIGHTS[light])


def _entrant(policy: str) -> Entrant:
    return Entrant.of(policy, 2)


POLICIES = (DEFAULT_POLICY, "fixed", "majer2018-standard", "begin2022", "begin2022-code")
ASIDE_M, TURNED_RAD = 0.3, math.radians(5.0)  # Where the robot starts beside the path
LOST_M = 1.0  # A lap that was not completed counts as this far aside
AT_MOST_M = 0.1  # How far aside a robot may be at the end of a lap


def measure_laps(seed: int, policy: str, light: str, laps: int) -> list[dict[str, Any]]:
    """Repeat a path in one light, lap after lap, until one is not completed: a row for each of the laps."""
    path = ParkPath(seed, 0.0)
    lesson = taught(path, seed, policy, path.length_m)
    repeater = LapRepeater(lesson, light, policy, aside_m=ASIDE_M, turned_rad=TURNED_RAD)
    rows = [_row(repeater.lap())]
    while rows[-1]["completed"] and len(rows) < laps:
        rows.append(_row(repeater.lap()))
    return rows


def _row(lap: DrivenLap) -> dict[str, Plain]:
    return {
        "completed": lap.completed, "stop": str(lap.stop), "end_m": float(lap.aside_m[-1]) if lap.completed else LOST_M,
        "mean_m": float(lap.aside_m.mean()), "max_m": float(lap.aside_m.max()),
        "registered": float(lap.registered.mean()), "driven_m": SPEED_M_S * PERIOD_S * len(lap.aside_m),
    }  # fmt: skip
