"""What no policy can know about a replay: the best fixed exposure, and the one with most votes image by image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.experiments.teach.daylight import TEACHING
from evaluation.experiments.teach.operator_setting import at_half
from evaluation.experiments.worth.names import FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME
from evaluation.experiments.worth.registration.replays import CHOICE, SCORING, Look, Replay
from evaluation.stage.camera import LIMITS, time_first
from fake_camera.world.render.renderer import Renderer
from navigation.views.features import Features, OrbPyramid
from navigation.views.registration import Vote, register

STOPS = range(-4, 2)
"""Exposures tried, from the one that gives the first view a mean of one half; time before gain, since nothing blurs at
this speed."""

Levels = list[int]
"""Exposure levels, whole stops."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Shares of registrations within 5 px, mean over repeats: on one's own maps, and on the foreign ones."""

    own: float
    foreign: float


def bounds(course: Replay, foreign: Sequence[Features]) -> dict[str, Outcome]:
    """Both bounds, chosen with one noise and scored with others.

    `fixed-in-hindsight` keeps one exposure while it teaches and while it replays; on foreign maps only the latter
    matters. `oracle-per-frame` has for each image the exposure with most votes, and has taught each of its maps with
    that which gives its images most votes.

    Parameters
    ----------
    course
        The replay.
    foreign
        Features of each foreign map.
    """
    looks, renderers = course.looks(), course.renderers()
    choice, *scoring = (_Sight(course, looks, renderers, foreign, repeat) for repeat in (CHOICE, *SCORING))
    taught, seen = choice.levels()
    plans = {
        FIXED_IN_HINDSIGHT: _fixed(choice, sorted({*taught, *seen})),
        ORACLE_PER_FRAME: _free(choice, taught, seen),
    }
    return {
        name: Outcome(
            float(np.mean([sight.share(sight.own(maps, images)) for sight in scoring])),
            float(np.mean([sight.share(sight.on_foreign(others)) for sight in scoring])),
        )
        for name, (maps, images, others) in plans.items()
    }


class _Sight:
    """The maps and images of a replay at any exposure level, with the noise of one repeat."""

    def __init__(
        self,
        course: Replay,
        looks: Sequence[Look],
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

    def _each(self, images: Levels) -> enumerate[tuple[Look, int]]:
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


_Plan = tuple[Levels, Levels, Levels]
"""Levels of the maps, and of the images on one's own and on foreign maps."""


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
