"""Local maps kept up over hours and months in every way, on the same views, and how well they register."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, get_args

import numpy as np

from evaluation.arrays import Floats, Ints
from evaluation.experiments.navigation.seasons import HOURS, TAUGHT, ParkScene, When, months
from evaluation.experiments.teach.park import MAPS, ParkPath
from evaluation.experiments.teach.replay import ExposingRobot, TrueShifts
from evaluation.jobs.job import Plain
from evaluation.stage.camera import Entrant, Image, SimulatedCamera
from navigation.maps.adaptation import LocalMap, Strategy, adapt, best, drawn, states_of
from navigation.maps.temporal import MODELS, FeatureHistory, Predict, fremen
from navigation.views.features import AdaptiveFinder, FastOrb, Features
from navigation.views.registration import RULES, Registration, VoteRule, register

EXPOSURE = "majer2018-standard"  # The paper's, with which it made its maps
PLACES = 20  # Of the 80 local maps of a path, every fourth
# Frames taken at each place, so that exposure and threshold have settled, and the last ones, which are searched.
STILL_FRAMES, FOUND_FRAMES = 10, 3
PART: Final = "top half"  # Where all but one of `FINDERS` look


class FixedFinder(AdaptiveFinder):
    """Keeps the threshold that the first place settled."""

    def __init__(self) -> None:
        super().__init__(FastOrb(), PART)
        self._seen = 0

    def find(self, image: Image) -> Features:
        """As `AdaptiveFinder`, whose threshold moves for the pictures of the first place only."""
        kept = self.threshold
        features = super().find(image)
        self._seen += 1
        if self._seen > FOUND_FRAMES:
            self.threshold = kept
        return features


# What sets the threshold: the responses in the upper half, in the whole image, or nobody. The features themselves are
# taken from the upper half in the first and the last.
FINDERS: dict[str, Callable[[], AdaptiveFinder]] = {
    "upper half": lambda: AdaptiveFinder(FastOrb(), PART),
    "whole image": lambda: AdaptiveFinder(FastOrb(), "whole image"),
    "fixed threshold": FixedFinder,
}


@dataclass(frozen=True, slots=True, eq=False)
class MapLook:
    """A view near a local map."""

    features: dict[str, Features]  # by finder
    shift_px: float  # by how much the view is shifted to the right in truth; NaN where nothing upright is seen in both


class Surveyor:
    """Drives a path of a park; its finders keep their thresholds from drive to drive. `finders`: names of `FINDERS`."""

    def __init__(self, seed: int, finders: Sequence[str]) -> None:
        self._seed, self._path = seed, ParkPath(seed, 0.0)
        self._finders = {name: FINDERS[name]() for name in finders}
        self._places = range(0, MAPS, MAPS // PLACES)
        scene = ParkScene(seed, TAUGHT.daylight(0))
        self._truth = TrueShifts(scene.surfaces)
        poses = [self._path.taught(place) for place in self._places]
        self.taught = [MapLook(features, 0.0) for features in self._found(scene, poses, camera=2 * seed)]
        """What is seen from where the maps are taught."""

    def drive(self, number: int, when: When) -> list[MapLook]:
        """The looks of one drive, counted from 1, at each place."""
        poses = [self._path.repeated(number, place * self._path.spacing_m) for place in self._places]
        shifts = [
            self._truth.shift(self._path.taught(place), pose) for place, pose in zip(self._places, poses, strict=True)
        ]
        found = self._found(ParkScene(self._seed, when.daylight(number)), poses, camera=2 * self._seed + number)
        return [MapLook(features, shift) for features, shift in zip(found, shifts, strict=True)]

    def _found(self, scene: ParkScene, poses: Sequence[Floats], camera: int) -> Iterator[dict[str, Features]]:
        robot: ExposingRobot | None = None
        for pose in poses:
            radiance = scene.radiance(pose)
            robot = robot or ExposingRobot(SimulatedCamera(camera, camera), radiance, [Entrant.of(EXPOSURE, 2)])
            images = [robot.step(radiance)[EXPOSURE] for _ in range(STILL_FRAMES)]
            for image in images[-FOUND_FRAMES:]:
                features = {name: finder.find(image) for name, finder in self._finders.items()}
            yield features


class Kept:
    """A local map that one strategy keeps up."""

    def __init__(self, taught: Features, strategy: Strategy, rule: VoteRule) -> None:
        self.map = LocalMap.taught(taught)
        self._strategy, self._rule, self._next_id = strategy, rule, len(taught)

    def look(self, seen: Features) -> tuple[float | None, Registration]:
        """The shift of a view against the map (pixels), which is then kept up."""
        registration = register(self.map.features, seen, self._rule)
        passing = adapt(self.map, seen, registration, self._strategy, self._next_id)
        self.map = passing.after
        self._next_id += int(passing.added.sum())
        return registration.vote.shift_px, registration


class Remembered:
    """A local map of strategy `summary` and what was seen of each of its features when. A feature that has left is
    forgotten."""

    def __init__(self, taught: Features, rule: VoteRule) -> None:
        self._kept, self._rule = Kept(taught, "summary", rule), rule
        self._times_s: list[float] = []
        self._states: list[dict[int, int]] = []

    def look(self, seen: Features, time_s: float) -> None:
        """Learn from a view."""
        before = self._kept.map
        shift_px, registration = self._kept.look(seen)
        if shift_px is not None:
            states = states_of(len(before), registration)
            self._times_s.append(time_s)
            self._states.append(dict(zip(before.ids.tolist(), states.tolist(), strict=True)))

    @property
    def map(self) -> LocalMap:
        """As it is now."""
        return self._kept.map

    def history(self) -> FeatureHistory:
        """Of the features that it has now."""
        ids = self.map.ids.tolist()
        states = [[passing.get(one, 0) for one in ids] for passing in self._states]
        passed = [[one in passing for one in ids] for passing in self._states]
        shape = (len(self._states), len(ids))
        return FeatureHistory(
            np.array(self._times_s), np.array(states, np.int8).reshape(shape), np.array(passed, bool).reshape(shape)
        )

    def register(self, seen: Features, which: Ints) -> float | None:
        """The shift of a view (pixels) against some of its features."""
        return register(self.map.features.take(which), seen, self._rule).vote.shift_px


PAPERS = "fremen, as the paper"  # One period, a day, and always used
# What says which features will be seen, by name.
MODELS_COMPARED = {PAPERS: lambda history: fremen(history, order=1, periods_s=(86_400.0,)), **MODELS}
DRAWN = "fremen, drawn"  # Features drawn by their probability (Monte Carlo), instead of the most probable ones
ALL = "all features"  # No choice


def foretold(
    remembered: Remembered, tests: Sequence[tuple[float, Features]], seed: int
) -> dict[str, list[float | None]]:
    """Shifts found (pixels) at given times, by model; the models learn from what was seen before the first."""
    history = remembered.history()
    models: dict[str, Predict] = {name: learn(history) for name, learn in MODELS_COMPARED.items()}
    random = np.random.default_rng([seed, 53])
    shifts: dict[str, list[float | None]] = {name: [] for name in (*models, DRAWN, ALL)}
    for time_s, seen in tests:
        scores = {name: predict(time_s) for name, predict in models.items()}
        chosen = {name: best(one) for name, one in scores.items()}
        chosen[DRAWN] = drawn(scores["fremen"], random)
        chosen[ALL] = np.arange(len(remembered.map))
        for name, which in chosen.items():
            shifts[name].append(remembered.register(seen, which))
    return shifts


LEARNT = 57  # Of the drives of the months, as in the paper; the rest is foretold
PAPERS_FINDER = "upper half"
# Finder and strategy of each way to keep a map up.
STRATEGIES: dict[str, tuple[str, Strategy]] = {name: (PAPERS_FINDER, name) for name in get_args(Strategy)}
# Other ways to set the threshold, with maps that stay as they are.
THRESHOLDS: dict[str, tuple[str, Strategy]] = {name: (name, "static") for name in FINDERS if name != PAPERS_FINDER}
# Shifts found (pixels, None for none) by rule and by what kept the map up, by drive and place.
Shifts = dict[str, dict[str, list[list[float | None]]]]


class Maps:
    """All local maps of a path, kept up in several ways and registered by each rule. `shifts`: those of the drives that
    are scored."""

    def __init__(self, taught: Sequence[MapLook], ways: Mapping[str, tuple[str, Strategy]]) -> None:
        self._ways = ways
        self._kept = {
            (rule, name): [Kept(look.features[finder], strategy, RULES[rule]) for look in taught]
            for rule, (name, (finder, strategy)) in product(RULES, ways.items())
        }
        self.shifts: Shifts = {rule: {name: [] for name in ways} for rule in RULES}

    def drive(self, looks: Sequence[MapLook], *, scored: bool) -> None:
        """Register the looks of a drive, and keep the maps up."""
        for (rule, name), maps in self._kept.items():
            finder = self._ways[name][0]
            row = [one.look(look.features[finder])[0] for one, look in zip(maps, looks, strict=True)]
            if scored:
                self.shifts[rule][name].append(row)


def measure_hours(seed: int, programme: str, drives: int) -> Plain:
    """Some drives of one of `HOURS` in a park, from its first to its last. Returns `truth`, shifts (pixels, NaN for
    none) by drive and place, and `shifts`, as `Shifts`."""
    surveyor = Surveyor(seed, list(FINDERS))
    maps = Maps(surveyor.taught, STRATEGIES | THRESHOLDS)
    truth: list[list[float]] = []
    hours = HOURS[programme]()
    chosen = [hours[place] for place in np.linspace(0, len(hours) - 1, drives).round().astype(int)]
    for number, when in enumerate(chosen, 1):
        looks = surveyor.drive(number, when)
        maps.drive(looks, scored=True)
        truth.append([look.shift_px for look in looks])
    return {"truth": truth, "shifts": maps.shifts}


def measure_months(seed: int) -> Plain:
    """The drives of two months in a park: as `measure_hours`, of those after the first `LEARNT` only. Besides the
    strategies, which go on learning, there are the models, which foretell from what was learnt."""
    surveyor = Surveyor(seed, [PAPERS_FINDER])
    maps = Maps(surveyor.taught, STRATEGIES)
    remembered = {
        rule: [Remembered(look.features[PAPERS_FINDER], RULES[rule]) for look in surveyor.taught] for rule in RULES
    }
    tests: list[list[tuple[float, Features]]] = [[] for _ in surveyor.taught]
    truth: list[list[float]] = []
    for number, when in enumerate(months(seed), 1):
        looks = surveyor.drive(number, when)
        maps.drive(looks, scored=number > LEARNT)
        if number <= LEARNT:
            for places in remembered.values():
                for place, look in zip(places, looks, strict=True):
                    place.look(look.features[PAPERS_FINDER], when.time_s)
        else:
            truth.append([look.shift_px for look in looks])
            for test, look in zip(tests, looks, strict=True):
                test.append((when.time_s, look.features[PAPERS_FINDER]))
    for rule, places in remembered.items():
        by_place = [foretold(place, test, seed) for place, test in zip(places, tests, strict=True)]
        for name in by_place[0]:
            maps.shifts[rule][name] = [list(row) for row in zip(*(one[name] for one in by_place), strict=True)]
    return {"truth": truth, "shifts": maps.shifts}
