"""Judge: odometry on short drives through rooms with natural texture, with every policy in closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arrays import Floats
from evaluation.committed import REPORT_ROOM, ROOMS, TUNING_ROOM
from evaluation.experiments.worth.contenders import CONTENDERS, Contender, medians
from evaluation.experiments.worth.matches.judge import PREPARATIONS
from evaluation.experiments.worth.tables import FIXED_IN_HINDSIGHT
from evaluation.jobs.job import Job, Plain
from evaluation.odometry.orb import in_house
from evaluation.odometry.stereo import SUB_TRAJECTORY_M, relative_errors_mm
from evaluation.odometry.tracking import EVERY, illumination, lap, lost_for_good, true_pose
from evaluation.scenes.scenarios import RATE_HZ, Course, no_turn, steady
from evaluation.scenes.stills import PAINTERS, digest, picture, stills
from evaluation.scenes.views import CAMERA, Feature, natural_room
from evaluation.stage.camera import LIMITS, DelayedLoop, SimulatedCamera
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import BOTH, Stage
from fake_camera.world.render.renderer import Renderer, Surface
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting
from imaging.python310 import exp2
from imaging.response import ResponseFunction

Kind = Literal["plain", "dim", "uneven", "window", "lamps", "tunnel"]

# Light on the walls where the drive begins, least and most.
LUX: dict[Kind, tuple[float, float]] = {
    "plain": (10.0, 2000.0), "dim": (1.0, 8.0), "uneven": (1.0, 60.0), "window": (2.0, 100.0), "lamps": (2.0, 200.0),
    "tunnel": (60.0, 2000.0),
}  # fmt: skip

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
class RoomDrive:
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
        left, right = (RoomView(renderer, self.path, camera) for camera in ("left", "right"))
        still = Course(steady(1.0), no_turn, 0)  # the light is baked in
        return Stage({"left": left, "right": right}, still, self.noise_seed(SEEN))

    def noise_seed(self, repeat: int) -> int:
        """Of the noise of a repeat."""
        return 100 * self.seed + repeat

    def plain(self) -> dict[str, Any]:
        """As a job's argument."""
        return {**asdict(self), "pictures": list(self.pictures), "sha256": list(self.sha256)}

    @classmethod
    def of(cls, plain: dict[str, Any]) -> RoomDrive:
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


def drives(name: str) -> list[RoomDrive]:
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
        found.append(RoomDrive(pictures, first + place, kind, lux, speeds[step % len(speeds)], sha256=sha256))
    return found


def quick_part(courses: Sequence[RoomDrive]) -> list[RoomDrive]:
    """Half of the first past a window at medium speed: a slow one would not come 20 mm far."""
    some = next(drive for drive in courses if (drive.kind, drive.speed) == ("window", "medium"))
    return [replace(some, seconds=SECONDS / 2)]


_picture = cache(picture)


# The error of an odometry that never moves. No sub-trajectory counts as more, and failed runs are listed as this.
WORST_MM = 1e3 * SUB_TRAJECTORY_M


class RunFollower:
    """In-house odometry on one run, for each preparation of its frames. `stage`: the drive's; its own noise does not
    matter. `drive`, `repeat`: decide the noise of the frames."""

    def __init__(self, stage: Stage, drive: RoomDrive, repeat: int) -> None:
        seed = drive.noise_seed(repeat)
        self._stage = stage
        self._cameras = {camera: SimulatedCamera(2 * seed + (camera == "right"), seed) for camera in BOTH}
        self._truth: list[Floats] = []
        self._odometry = {name: in_house() for name in PREPARATIONS}
        self._estimates: dict[str, list[Floats]] = {name: [] for name in PREPARATIONS}
        self._lost: dict[str, list[bool]] = {name: [] for name in PREPARATIONS}

    def look(self, setting: ExposureSetting) -> None:
        """Take the present frame with a setting and track it, unless that is of no use any more."""
        following = [name for name in PREPARATIONS if not self.failed(name)]
        if not following:
            return
        left, right = (
            camera.expose(
                self._stage.radiance(camera_name, setting.exposure_time_us * 1e-6), setting, self._stage.frame
            )
            for camera_name, camera in self._cameras.items()
        )
        self._truth.append(true_pose(self._stage, setting))
        for name in following:
            tracked = self._odometry[name].track(PREPARATIONS[name](left), PREPARATIONS[name](right))
            self._estimates[name].append(tracked.pose)
            self._lost[name].append(tracked.lost)

    def failed(self, name: str) -> bool:
        """Whether tracking was lost for good with a preparation."""
        return lost_for_good(self._lost[name])

    def error_mm(self, name: str) -> float:
        """Mean translation RPE over sub-trajectories of 20 mm, guesses for lost pairs included."""
        if self.failed(name):
            return WORST_MM
        return float(np.minimum(relative_errors_mm(self._truth, self._estimates[name]), WORST_MM).mean())


DELAY_FRAMES = 2
# Levels tried in hindsight, from the one at which a white wall in the first light is just below saturation.
TRIED_STOPS = (-3.0, -1.5, 0.0, 1.5)
WHITE_US_LUX = 2000.0 * 150.0  # Such a wall: 2 ms at 150 lux
LONGEST_US = 3000.0  # Of these settings, unless the most gain needs more: hardly any blur


def measure_contender(*, drives: list[dict[str, Any]], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return [row for drive in drives for row in run(RoomDrive.of(drive), CONTENDERS[contender])]


def measure_hindsight(*, drives: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight`."""
    return [row for drive in drives for row in hindsight(RoomDrive.of(drive))]


def run(drive: RoomDrive, contender: Contender) -> list[dict[str, Any]]:
    """Rows of a contender, which starts from the best exposure of the first frame. It decides on frames with one noise;
    its settings are scored with others."""
    stage = drive.stage()
    start = best_start(Oracle(stage))
    loop = DelayedLoop(contender.make_loop(ResponseFunction.linear(), LIMITS, start), DELAY_FRAMES)
    followers = _followers(stage, drive, SCORED)
    for frame in range(drive.frames):
        stage.go_to(frame)
        pair = loop.step(stage.take)
        if frame % EVERY == 0:
            for follower in followers:
                follower.look(pair.reference.setting)
    return _rows(drive, contender.name, dict.fromkeys(PREPARATIONS, followers), medians(loop.settings))


def hindsight(drive: RoomDrive) -> list[dict[str, Any]]:
    """Rows of the fixed setting with the smallest error of those tried, chosen with other noise by preparation."""
    stage = drive.stage()
    levels = [float(np.log2(WHITE_US_LUX / drive.lux)) + stops for stops in TRIED_STOPS]
    tried = [LIMITS.realise(level, min(exp2(level), LONGEST_US)) for level in levels]
    chosen = _followed(stage, drive, (CHOICE,), tried)
    best = {name: min(tried, key=lambda one: _error_mm(chosen[one], name)) for name in PREPARATIONS}
    scored = _followed(stage, drive, SCORED, list(best.values()))
    return _rows(drive, FIXED_IN_HINDSIGHT, {name: scored[setting] for name, setting in best.items()}, {})


def _followers(stage: Stage, drive: RoomDrive, repeats: Sequence[int]) -> list[RunFollower]:
    return [RunFollower(stage, drive, repeat) for repeat in repeats]


def _followed(
    stage: Stage, drive: RoomDrive, repeats: Sequence[int], settings: list[ExposureSetting]
) -> dict[ExposureSetting, list[RunFollower]]:
    followed = {setting: _followers(stage, drive, repeats) for setting in settings}
    for frame in range(0, drive.frames, EVERY):
        stage.go_to(frame)
        for setting, followers in followed.items():
            for follower in followers:
                follower.look(setting)
    return followed


def _error_mm(followers: Sequence[RunFollower], kind: str) -> float:
    """Geometric mean over the noises."""
    return float(np.exp(np.mean([np.log(follower.error_mm(kind)) for follower in followers])))


def _rows(
    drive: RoomDrive, name: str, followers: Mapping[str, Sequence[RunFollower]], more: Mapping[str, float]
) -> list[dict[str, Any]]:
    """One plain row for each judge, given who followed each preparation. It has failed if it has with any noise."""
    base = {"course": drive.name, "policy": name}
    failed = {kind: [follower.failed(kind) for follower in each] for kind, each in followers.items()}
    errors = [
        {"judge": f"odometry-{kind}", **base, "value": _error_mm(each, kind), "failed": any(failed[kind]), **more}
        for kind, each in followers.items()
    ]
    return [*errors, {"judge": "odometry-failures", **base, "value": float(np.mean(list(failed.values())))}]


# Translation RPE over 20 mm (mm) on frames as they are and preprocessed; share of these runs that failed.
JUDGES: dict[str, Literal["higher", "lower"]] = {
    **{f"odometry-{name}": "lower" for name in PREPARATIONS},
    "odometry-failures": "lower",
}

GROUP = len(LUX)  # Drives of a job, one of each kind
# Everyone drives through every so many groups: enough to tell a policy that is worse by a third. The default, its
# closest rivals on tuning rooms, and whoever was undecided after that drive through all.
SCREENED_EVERY = 4
CLOSEST = (
    DEFAULT_POLICY, "begin2022", "begin2022-code", "berthold2013", "tomasi2021", "zhang2024", "shim2018", "mehta2020",
    "majer2018-standard", "majer2018-full", "zhang2017",
)  # fmt: skip
SET_UP_S, COST_PER_S = 2.0, 5.5  # Seconds of one core to build a room, and for a second of a drive with one contender


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of the tuning or the report set: the contenders by groups of drives, and the best in hindsight."""
    courses = quick_part(drives(name)) if quick else drives(name)
    bounds = [
        Job(measure_hindsight, {"drives": group}, cost_s * (len(TRIED_STOPS) + 1), ())
        for group, cost_s in _groups(_screening(courses))
    ]
    others = [one for one in CONTENDERS if one not in CLOSEST]
    return [*bounds, *contender_jobs(courses, CLOSEST), *contender_jobs(_screening(courses), others)]


def _screening(courses: Sequence[RoomDrive]) -> list[RoomDrive]:
    """Every fourth group: all kinds, speeds and lights, three of each."""
    return [drive for place, drive in enumerate(courses) if place // GROUP % SCREENED_EVERY == 0]


def contender_jobs(courses: Sequence[RoomDrive], contenders: Sequence[str]) -> list[Job]:
    """One for each group of drives and each of `CONTENDERS`: a change of one leaves the results of the others kept."""
    return [
        Job(measure_contender, {"drives": group, "contender": one}, cost_s, (CONTENDERS[one].policy_id,))
        for group, cost_s in _groups(courses)
        for one in contenders
    ]


def _groups(courses: Sequence[RoomDrive]) -> list[tuple[list[Plain], float]]:
    """Drives that a job takes together, and what one contender on them costs (s of one core)."""
    groups = [courses[first : first + GROUP] for first in range(0, len(courses), GROUP)]
    return [
        ([drive.plain() for drive in group], sum(SET_UP_S + COST_PER_S * drive.seconds for drive in group))
        for group in groups
    ]
