"""What a robot sees of the local maps of a path, drive after drive: features, and by how much each view is shifted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.navigation.scene import Scene
from evaluation.experiments.navigation.seasons import TAUGHT, When
from evaluation.experiments.teach.path import MAPS, TaughtPath
from evaluation.experiments.teach.registration import Truth
from evaluation.experiments.teach.replay import Robot
from evaluation.stage.camera import Image, SimulatedCamera
from evaluation.stage.delayed_loop import Entrant
from navigation.views.detectors import AdaptiveFinder, FastOrb
from navigation.views.features import Features

EXPOSURE = "majer2018-standard"
"""The paper's, with which it made its maps."""

PLACES = 20
"""Of the 80 local maps of a path, every fourth."""

STILL_FRAMES, FOUND_FRAMES = 10, 3
"""Frames taken at each place, so that exposure and threshold have settled, and the last ones, which are searched."""

PART: Final = "top half"
"""Where all but one of `FINDERS` look."""


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


FINDERS: dict[str, Callable[[], AdaptiveFinder]] = {
    "upper half": lambda: AdaptiveFinder(FastOrb(), PART),
    "whole image": lambda: AdaptiveFinder(FastOrb(), "whole image"),
    "fixed threshold": FixedFinder,
}
"""What sets the threshold: the responses in the upper half, in the whole image, or nobody. The features themselves are
taken from the upper half in the first and the last."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A view near a local map.

    Attributes
    ----------
    features
        By finder.
    shift_px
        By how much the view is shifted to the right in truth; NaN where nothing upright is seen in both.
    """

    features: dict[str, Features]
    shift_px: float


class Surveyor:
    """Drives a path of a park; its finders keep their thresholds from drive to drive.

    Parameters
    ----------
    seed
        Of the park.
    finders
        Names of `FINDERS`.
    """

    def __init__(self, seed: int, finders: Sequence[str]) -> None:
        self._seed, self._path = seed, TaughtPath(seed, 0.0)
        self._finders = {name: FINDERS[name]() for name in finders}
        self._places = range(0, MAPS, MAPS // PLACES)
        scene = Scene(seed, TAUGHT.daylight(0))
        self._truth = Truth(scene.surfaces)
        poses = [self._path.taught(place) for place in self._places]
        self.taught = [Look(features, 0.0) for features in self._found(scene, poses, camera=2 * seed)]
        """What is seen from where the maps are taught."""

    def drive(self, number: int, when: When) -> list[Look]:
        """The looks of one drive, counted from 1, at each place."""
        poses = [self._path.repeated(number, place * self._path.spacing_m) for place in self._places]
        shifts = [
            self._truth.shift(self._path.taught(place), pose) for place, pose in zip(self._places, poses, strict=True)
        ]
        found = self._found(Scene(self._seed, when.daylight(number)), poses, camera=2 * self._seed + number)
        return [Look(features, shift) for features, shift in zip(found, shifts, strict=True)]

    def _found(self, scene: Scene, poses: Sequence[NDArray[np.float64]], camera: int) -> Iterator[dict[str, Features]]:
        robot: Robot | None = None
        for pose in poses:
            radiance = scene.radiance(pose)
            robot = robot or Robot(SimulatedCamera(camera, camera), radiance, [Entrant.of(EXPOSURE, 2)])
            images = [robot.step(radiance)[EXPOSURE] for _ in range(STILL_FRAMES)]
            for image in images[-FOUND_FRAMES:]:
                features = {name: finder.find(image) for name, finder in self._finders.items()}
            yield features
