"""Where the default loses most: its frames, beside those of the best fixed setting."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.drawing import save
from evaluation.experiments.experiment import Results, Table
from evaluation.experiments.worth.contender import policy
from evaluation.experiments.worth.matches.closed_loop import enter
from evaluation.experiments.worth.matches.courses import Course
from evaluation.experiments.worth.matches.groups import SHOWN, courses_of
from evaluation.experiments.worth.matches.rig import Rig
from evaluation.experiments.worth.matches.scoring import JUDGES, SCORING_SEEDS
from evaluation.experiments.worth.names import FIXED_IN_HINDSIGHT
from evaluation.experiments.worth.tables import Verdicts
from imaging.exposure import ExposureSetting
from imaging.frames import Frame

WORST = 3
"""Courses shown."""

FRAMES = 5
"""Shown of each, spread over what is scored."""

_LEAST = {"higher": 1.0, "lower": 0.01}
"""Added to matches, and to errors in pixels: a ratio of two tiny values says nothing."""


def worst_courses(results: Results, verdicts: Verdicts) -> list[tuple[Course, float]]:
    """Courses where the default is furthest behind the best fixed setting, by the mean ratio of `SHOWN` (stops)."""
    behind = [
        (course, float(np.mean([_behind(verdicts, judge, name) for judge in SHOWN])))
        for name, course in courses_of(results).items()
    ]
    return sorted(behind, key=lambda one: -one[1])[:WORST]


def _behind(verdicts: Verdicts, judge: str, course: str) -> float:
    own, best = (verdicts.mean(judge, name, [course]) for name in (DEFAULT_POLICY, FIXED_IN_HINDSIGHT))
    least = _LEAST[JUDGES[judge]]
    ratio = math.log2((best + least) / (own + least))
    return ratio if JUDGES[judge] == "higher" else -ratio


def worst_table(worst: list[tuple[Course, float]], verdicts: Verdicts) -> Table:
    """The values of both on these courses."""
    rows = []
    for course, _ in worst:
        cells = []
        for judge in SHOWN:
            own, best = (verdicts.mean(judge, name, [course.name]) for name in (DEFAULT_POLICY, FIXED_IN_HINDSIGHT))
            cells.append(f"{own:.3g} / {best:.3g}")
        rows.append([course.name, *cells])
    caption = f"Where `{DEFAULT_POLICY}` loses most: its value / that of `{FIXED_IN_HINDSIGHT}`."
    return Table(caption, ["course", *(f"`{judge}`" for judge in SHOWN)], rows)


def plot_worst(worst: list[tuple[Course, float]], results: Results, file: Path) -> None:
    """Frames of both through these courses, taken again."""
    figure, grid = plt.subplots(
        2 * len(worst), FRAMES, figsize=(9.0, 0.2 + 3.2 * len(worst)), layout="constrained", squeeze=False
    )
    for place, (course, _) in enumerate(worst):
        fixed = _fixed(results, course.name)
        for row, frames in zip(grid[2 * place : 2 * place + 2], _frames(course, fixed), strict=True):
            for axes, frame in zip(row, frames, strict=True):
                axes.imshow(frame.grey8(), cmap="gray", vmin=0, vmax=255)
                axes.set(xticks=[], yticks=[])
                axes.set_title(f"{frame.frame_id}: {frame.setting}", fontsize=6)
        grid[2 * place, 0].set_ylabel(DEFAULT_POLICY, fontsize=7)
        grid[2 * place + 1, 0].set_ylabel(FIXED_IN_HINDSIGHT, fontsize=7)
        # Room for the course's name, which must not widen its column.
        grid[2 * place, 0].set_title("\n" + grid[2 * place, 0].get_title(), fontsize=6)
        grid[2 * place, 0].text(0, -45, course.name, fontsize=8).set_in_layout(False)
    save(figure, file, dpi=110, colours=32)


def _fixed(results: Results, course: str) -> ExposureSetting:
    """The setting that `SHOWN[0]` chose for a course."""

    def is_it(row: Mapping[str, Any]) -> bool:
        return (row["judge"], row["course"], row["policy"]) == (SHOWN[0], course, FIXED_IN_HINDSIGHT)

    row = next(row for _, found in results for row in found if is_it(row))
    return ExposureSetting(row["time_us"], row["gain_db"])


def _frames(course: Course, fixed: ExposureSetting) -> tuple[list[Frame], list[Frame]]:
    film = course.film()
    rig = Rig(film, course.eyes, SCORING_SEEDS[0])
    loop = enter(policy(DEFAULT_POLICY), course)
    shown = {course.scored[place] for place in np.linspace(0, len(course.scored) - 1, FRAMES).round().astype(int)}
    own, beside = [], []
    for number in range(course.frames):
        film.go_to(number)
        frame = loop.step(rig.take).frames["left"]
        if number in shown:
            own.append(frame)
            beside.append(rig.expose("left", fixed))
    return own, beside
