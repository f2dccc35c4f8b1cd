"""Judge: registration with one's own and with foreign maps, outdoors, with every policy in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from evaluation.arrays import Floats
from evaluation.committed import REPORT_PARK, TUNING_PARK
from evaluation.experiments.teach.judge import TILTS, WITHIN_PX
from evaluation.experiments.teach.park import MAPS as PATH_MAPS
from evaluation.experiments.teach.park import REPLAYS, TEACHING, Daylight, ParkPath, park
from evaluation.experiments.teach.replay import (
    DELAY_FRAMES,
    Stretch,
    TrueShifts,
    at_half,
    frames,
    image_of,
    replayed,
    taught_maps,
)
from evaluation.experiments.worth.contenders import APART, CONTENDERS, PUBLISHED, Contender, policy
from evaluation.experiments.worth.tables import FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME
from evaluation.jobs.job import Job, Plain
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import LIMITS, Entrant, SimulatedCamera, time_first
from fake_camera.world.render.renderer import Renderer, Surface
from navigation.views.features import Features, OrbPyramid
from navigation.views.registration import Vote, register

MAPS = 10  # Of the 80 along a path, with eight images each
# Repeats (noise) on which bounds are chosen, and on which they are scored; policies run on the first of these.
CHOICE, SCORING = 0, (1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class ReplayLook:
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
class ParkReplay:
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
    def path(self) -> ParkPath:
        """Where the robot goes."""
        return ParkPath(self.seed, TILTS[self.sky])

    def stretch(self, entrants: Sequence[Entrant] = ()) -> Stretch:
        """Its part of the path, and who drives there."""
        return Stretch(self.path, self.maps, self.first, entrants)

    def renderers(self) -> tuple[Renderer, Renderer]:
        """The park when the path is taught, and when it is replayed."""
        before, after = (Renderer(_built(self.seed, day), CAMERA) for day in (TEACHING, REPLAYS[self.light]))
        return before, after

    def looks(self) -> list[ReplayLook]:
        """The images that are registered."""
        truth, path = TrueShifts(_built(self.seed, TEACHING)), self.path
        return [
            ReplayLook(index, pose, lux, truth.shift(path.taught(self.first + index), pose))
            for frame, pose, lux in frames(self.stretch(), self.light)
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


def replays(name: str) -> list[ParkReplay]:
    """Those of the tuning or the report set, in other parks each."""
    if name == "tuning":
        cases = [("clear", _UPPER), ("clear", _BEYOND), ("overcast", _UPPER), ("sunset", _BEYOND)]
        return _around(TUNING_PARK, cases, 60)
    clear = [("clear", _UPPER), ("clear", _BEYOND), ("clear", _HARDLY)]
    cases = [*clear, *clear[::2], ("overcast", _UPPER), ("overcast", _BEYOND), ("sunset", _UPPER)]
    return _around(REPORT_PARK, cases, 0)


def _around(seed: int, cases: Sequence[tuple[str, str]], first: int) -> list[ParkReplay]:
    """Each case in a park of its own, with stretches all around the path."""
    return [
        ParkReplay(seed + place, light, sky, (first + 30 * place) % PATH_MAPS)
        for place, (light, sky) in enumerate(cases)
    ]


# Exposures tried, from the one that gives the first view a mean of one half; time before gain, since nothing blurs at
# this speed.
STOPS = range(-4, 2)
Levels = list[int]  # Exposure levels, whole stops


def bounds(course: ParkReplay, foreign: Sequence[Features]) -> dict[str, tuple[float, float]]:
    """Shares of registrations within 5 px on one's own maps and on the foreign ones, mean over repeats, of both bounds.
    They are chosen with one noise and scored with others. `fixed-in-hindsight` keeps one exposure while it
    teaches and while it replays; on foreign maps only the latter matters. `oracle-per-frame` has for each image the
    exposure with most votes, and has taught each of its maps with that which gives its images most votes. `foreign`:
    features of each foreign map."""
    looks, renderers = course.looks(), course.renderers()
    choice, *scoring = (_Sight(course, looks, renderers, foreign, repeat) for repeat in (CHOICE, *SCORING))
    taught, seen = choice.levels()
    plans = {
        FIXED_IN_HINDSIGHT: _fixed(choice, sorted({*taught, *seen})),
        ORACLE_PER_FRAME: _free(choice, taught, seen),
    }
    return {
        name: (
            float(np.mean([sight.share(sight.own(maps, images)) for sight in scoring])),
            float(np.mean([sight.share(sight.on_foreign(others)) for sight in scoring])),
        )
        for name, (maps, images, others) in plans.items()
    }


class _Sight:
    """The maps and images of a replay at any exposure level, with the noise of one repeat."""

    def __init__(
        self,
        course: ParkReplay,
        looks: Sequence[ReplayLook],
        renderers: tuple[Renderer, Renderer],
        foreign: Sequence[Features],
        repeat: int,
    ) -> None:
        self.looks = looks
        self.maps, self._first = course.maps, course.first
        self._path, self._renderers, self._foreign, self._detector = course.path, renderers, foreign, OrbPyramid()
        self._cameras = course.camera(0, repeat), course.camera(1, repeat)
        self._known: dict[tuple[int, int, int], Features] = {}

    def levels(self) -> tuple[Levels, Levels]:
        """What is tried for maps, and for images."""
        first = (self._path.taught(self._first), TEACHING.lux(0.0)), (self.looks[0].pose, self.looks[0].lux)
        halves = [
            round(at_half(camera, renderer.render(pose[None], lux)).level)
            for camera, renderer, (pose, lux) in zip(self._cameras, self._renderers, first, strict=True)
        ]
        low, high = LIMITS.darkest.level, LIMITS.brightest.level
        taught, seen = ([half + stops for stops in STOPS if low <= half + stops <= high] for half in halves)
        return taught, seen

    def own(self, maps: Levels, images: Levels) -> list[Vote]:
        """Votes of all images, at their levels, on maps taught at theirs."""
        return [self.vote(maps[look.index], level, place) for place, (look, level) in self._each(images)]

    def on_foreign(self, images: Levels) -> list[Vote]:
        """Votes of all images, at their levels, on the foreign maps."""
        return [self.foreign_vote(level, place) for place, (_, level) in self._each(images)]

    def share(self, votes: Sequence[Vote]) -> float:
        """Share of votes that are right."""
        return float(np.mean([look.found(vote) for look, vote in zip(self.looks, votes, strict=True)]))

    def vote(self, map_level: int, level: int, place: int) -> Vote:
        """The vote of one image at a level on its own map taught at another."""
        return register(self._seen(0, map_level, self.looks[place].index), self._seen(1, level, place)).vote

    def foreign_vote(self, level: int, place: int) -> Vote:
        """The vote of one image at a level on its foreign map."""
        return register(self._foreign[self.looks[place].index], self._seen(1, level, place)).vote

    def _each(self, images: Levels) -> enumerate[tuple[ReplayLook, int]]:
        return enumerate(zip(self.looks, images, strict=True))

    def _seen(self, drive: int, level: int, place: int) -> Features:
        """Features of a map (drive 0) or an image (drive 1)."""
        key = (drive, level, place)
        if key not in self._known:
            if drive:
                pose, lux = self.looks[place].pose, self.looks[place].lux
            else:
                pose, lux = self._path.taught(self._first + place), TEACHING.lux(0.0)
            radiance = self._renderers[drive].render(pose[None], lux)
            image = self._cameras[drive].expose(radiance, time_first(level), place)
            self._known[key] = self._detector.find(image, "top half")
        return self._known[key]


_Plan = tuple[Levels, Levels, Levels]  # Levels of the maps, and of the images on one's own and on foreign maps


def _fixed(sight: _Sight, levels: Levels) -> _Plan:
    """The level with the most right registrations; among equals, the most votes."""

    def worth(votes: Sequence[Vote]) -> tuple[float, int]:
        return sight.share(votes), sum(vote.votes for vote in votes)

    images = len(sight.looks)
    own = max(levels, key=lambda level: worth(sight.own([level] * sight.maps, [level] * images)))
    foreign = max(levels, key=lambda level: worth(sight.on_foreign([level] * images)))
    return [own] * sight.maps, [own] * images, [foreign] * images


def _free(sight: _Sight, taught: Levels, seen: Levels) -> _Plan:
    """The levels with most votes, map by map and image by image."""
    maps: Levels = []
    images: Levels = []
    for index in range(sight.maps):
        places = [place for place, look in enumerate(sight.looks) if look.index == index]
        votes = np.array([[[sight.vote(mine, its, at).votes for its in seen] for at in places] for mine in taught])
        best = int(votes.max(axis=2).sum(axis=1).argmax())
        maps.append(taught[best])
        images += [seen[which] for which in votes[best].argmax(axis=1)]
    others = [max(seen, key=lambda its: sight.foreign_vote(its, at).votes) for at in range(len(sight.looks))]
    return maps, images, others


# Taught the foreign maps: the paper's default, which meters as robots outdoors often do, by a part of the image.
TEACHER = "majer2018-standard"


def measure_policies(*, replay: dict[str, Any], policies: list[str]) -> list[dict[str, Any]]:
    """Rows of policies by their ids."""
    return run(ParkReplay(**replay), [policy(policy_id) for policy_id in policies])


def measure_bounds(*, replay: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight` and `oracle-per-frame`."""
    course = ParkReplay(**replay)
    before, _ = course.renderers()
    foreign = taught_maps(course.stretch([_entrant(policy(TEACHER))]), before, course.camera(0, SCORING[0]))
    found: list[dict[str, Any]] = []
    for name, shares in bounds(course, foreign["top half"][TEACHER]).items():
        found += [_row(judge, course, name, share) for judge, share in zip(JUDGES, shares, strict=False)]
    return found


def run(course: ParkReplay, contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Rows of contenders, each with its mean exposure level."""
    carried = {contender.name: _entrant(contender) for contender in (*contenders, policy(TEACHER))}
    before, after = course.renderers()
    stretch = course.stretch(list(carried.values()))
    taught = taught_maps(stretch, before, course.camera(0, SCORING[0]))["top half"]
    detector = OrbPyramid()
    own: dict[str, list[bool]] = {name: [] for name in carried}
    foreign: dict[str, list[bool]] = {name: [] for name in carried}
    saturated: dict[str, list[float]] = {name: [] for name in carried}
    levels: dict[str, list[float]] = {name: [] for name in carried}
    replay = replayed(stretch, after, course.camera(1, SCORING[0]), course.light)
    for look, (index, _, images, robot) in zip(course.looks(), replay, strict=True):
        for contender in contenders:
            name, image = contender.name, images[contender.name]
            seen = detector.find(image, "top half")
            own[name].append(look.found(register(taught[name][index], seen).vote))
            foreign[name].append(look.found(register(taught[TEACHER][index], seen).vote))
            saturated[name].append(float((image == 255).mean()))
            levels[name].append(robot.loops[name].settings[-1].level)
    found: list[dict[str, Any]] = []
    for name in (contender.name for contender in contenders):
        level = float(np.mean(levels[name]))
        found += [_row("registration-own", course, name, float(np.mean(own[name])), level)]
        found += [_row("registration-foreign", course, name, float(np.mean(foreign[name])), level)]
        if course.light == "clear":
            found += [_row("saturated-share", course, name, float(np.mean(saturated[name])), level)]
    return found


def _row(judge: str, course: ParkReplay, name: str, value: float, level: float | None = None) -> dict[str, Any]:
    row = {"judge": judge, "course": course.name, "policy": name, "value": value}
    return row if level is None else {**row, "level": level}


def _entrant(contender: Contender) -> Entrant:
    """A contender as it runs here; `fixed` keeps the operator's exposure, since that of a room would be white here."""
    if contender.policy_id == "fixed":
        return Entrant.of("fixed", DELAY_FRAMES)
    return Entrant(contender.name, DELAY_FRAMES, contender.make_loop)


# Share of registrations within 5 px of the truth, on maps that the policy taught itself and on `TEACHER`'s; share of
# saturated pixels under a clear sky, for which there are no bounds: the darkest setting would win.
JUDGES: dict[str, Literal["higher", "lower"]] = {
    "registration-own": "higher",
    "registration-foreign": "higher",
    "saturated-share": "lower",
}

QUICK = (TEACHER, "begin2022", "begin2022-code", "fixed")  # Of the published policies, in a quick run
_COST_S = 1.0  # Of one contender and one map (s of one core)


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of a set: by replay its bounds, the published policies together, and all others apart; a quick run has
    three maps of the first replay."""
    published = [one.policy_id for one in PUBLISHED if not quick or one.policy_id in QUICK]
    work: list[Job] = []
    for replay in [replace(replays(name)[0], maps=3)] if quick else replays(name):
        given: dict[str, Plain] = {"replay": replay.plain()}
        arguments: dict[str, Plain] = {**given, "policies": list(published)}
        cost_s = _COST_S * replay.maps
        work += [
            Job(measure_bounds, given, 8 * cost_s, (TEACHER,)),
            Job(measure_policies, arguments, cost_s * len(published), tuple(published)),
            *(
                Job(measure_contender, {**given, "contender": one.name}, 2 * cost_s, (one.policy_id, TEACHER))
                for one in APART
            ),
        ]
    return work


def measure_contender(*, replay: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(ParkReplay(**replay), [CONTENDERS[contender]])
