"""The scores of frames along a course, however their settings were chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from evaluation.experiments.worth.matches.courses import Course
from evaluation.experiments.worth.matches.pairs import PREPARATIONS, Seen, judged, seen
from evaluation.experiments.worth.matches.rig import Film
from imaging.exposure import ExposureSetting
from imaging.frames import Frame

PAIR_JUDGES: dict[str, Literal["higher", "lower"]] = {"matches-sift-raw": "higher"}
for _name in PREPARATIONS:
    PAIR_JUDGES |= {
        f"matches-orb-{_name}": "higher",
        f"repeatability-orb-{_name}": "higher",
        f"pose-error-orb-{_name}": "lower",
        f"lost-pairs-orb-{_name}": "lower",
        f"klt-error-{_name}": "lower",
        f"lost-pairs-klt-{_name}": "lower",
        f"lost-pairs-{_name}": "lower",
    }

BAD_FRAMES = "bad-frames"
"""Share of frames of which more than half is white or black."""

BLACK = 1
"""What rounding and read noise make of no light at all."""

JUDGES: dict[str, Literal["higher", "lower"]] = {**PAIR_JUDGES, BAD_FRAMES: "lower"}

CHOICE_SEED = 0
"""Noise on which bounds are chosen ..."""

SCORING_SEEDS = (1, 2, 3)
"""... and on which they are scored, else luck wins. Policies run on the first of these: three would cost thrice."""

CHECKED_EVERY = 4
"""Every fourth scored pair is tried with all settings of the grid, and judged by SIFT."""


class Scorer:
    """Judges the pairs of one camera as its frames come in.

    Attributes
    ----------
    pairs
        For each pair scored so far, the value of each judge that judged it.
    settings
        Of each frame that was looked at.
    """

    def __init__(self, course: Course, film: Film) -> None:
        self.pairs: list[dict[str, float]] = []
        self.settings: list[ExposureSetting] = []
        self._scored, self._film = course.scored, film
        self._last: tuple[int, float, Mapping[str, Seen]] | None = None
        self._bad: list[bool] = []

    def look(self, frame: Frame) -> None:
        """Take in the present frame of the film; one that odometry does not get is passed over."""
        number = self._film.frame
        if number not in self._scored:
            return
        self.settings.append(frame.setting)
        grey = frame.grey8()
        self._bad.append(bool(((grey <= BLACK) | (grey == 255)).mean() > 0.5))
        now = (number, frame.setting.exposure_time_us, seen(grey))
        if self._last is not None:
            truth = self._film.truth(self._last[:2], now[:2])
            sift = len(self.pairs) % CHECKED_EVERY == 0
            self.pairs.append(judged(self._last[2], now[2], truth, sift=sift))
        self._last = now

    def means(self) -> dict[str, float]:
        """Each judge's mean over the pairs that it judged, or over the frames."""
        return {**mean_values(self.pairs), BAD_FRAMES: float(np.mean(self._bad))}


def mean_values(pairs: list[dict[str, float]]) -> dict[str, float]:
    """Mean of each judge over the pairs that have its value."""
    return {judge: float(np.mean([pair[judge] for pair in pairs if judge in pair])) for judge in PAIR_JUDGES}


def rows(
    course: Course, policy: str, means: Mapping[str, float], more: Mapping[str, Mapping[str, Any]] | None = None
) -> list[dict[str, Any]]:
    """One plain row for each judge with a mean; `more` has diagnostics by judge."""
    return [
        {"judge": judge, "course": course.name, "policy": policy, "value": means[judge], **(more or {}).get(judge, {})}
        for judge in JUDGES
        if judge in means
    ]
