"""The experiment: all judges on the same contenders, and their section of the report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.committed import ERROR_MARGIN, FEATURE_MARGIN, ROOMS
from evaluation.drawing import save
from evaluation.experiments.experiment import Experiment, Figure, ReportSection, Results, Table
from evaluation.experiments.worth import odometry_judge, registration_judge
from evaluation.experiments.worth.contenders import OURS, policy
from evaluation.experiments.worth.matches import judge as matches_judge
from evaluation.experiments.worth.matches.courses import MatchesCourse, MatchesRig
from evaluation.experiments.worth.matches.judge import JUDGES, SCORING_SEEDS, enter
from evaluation.experiments.worth.matches.scenes import is_panorama
from evaluation.experiments.worth.odometry_judge import LONGEST_US, LUX, SECONDS, TRIED_STOPS, WORST_MM
from evaluation.experiments.worth.tables import (
    FIXED_IN_HINDSIGHT,
    NOT_COUNTED,
    Verdicts,
    claims_tables,
    means_tables,
    plot_gains,
)
from evaluation.jobs.job import Job, Plain
from evaluation.prose import text_beside
from imaging.exposure import ExposureSetting
from imaging.frames import Frame

# Of the judges, where the default loses most.
SHOWN = ("matches-orb-raw", "matches-orb-preprocessed", "pose-error-orb-raw", "klt-error-raw", "klt-error-preprocessed")


def matches_tables(
    results: Results, verdicts: Verdicts, rivals: Sequence[str], settings_of: Sequence[str]
) -> list[Table]:
    """Whether the default is inferior on hard courses, and the settings that contenders chose."""
    courses = courses_of(results)
    return [
        *_claims(verdicts, courses, [*rivals, *settings_of]),
        _settings(results, courses, [*settings_of, FIXED_IN_HINDSIGHT]),
    ]


def _claims(verdicts: Verdicts, courses: Mapping[str, MatchesCourse], rivals: Sequence[str]) -> list[Table]:
    """The judges that decide, on the courses that are hardest for exposure."""
    groups = {
        "In dim light, turning": {name for name, course in courses.items() if course.kind == "dim, turning"},
        "Pans over stills and paintings": {name for name, course in courses.items() if course.pan},
        "Panoramas": {name for name, course in courses.items() if is_panorama(course.scene)},
    }
    return [
        replace(table, caption=f"{title}: {table.caption}")
        for title, names in groups.items()
        if names
        for table in claims_tables(verdicts.among(names), [one for one in rivals if one != DEFAULT_POLICY])
    ]


def courses_of(results: Results) -> dict[str, MatchesCourse]:
    """The courses of this judge's jobs, by name; those of other judges have another form."""
    mine = [arguments for arguments, found in results if found and found[0]["judge"] in JUDGES]
    courses = [MatchesCourse(**arguments["course"]) for arguments in mine if isinstance(arguments["course"], dict)]
    return {course.name: course for course in courses}


def _settings(results: Results, courses: Mapping[str, MatchesCourse], policies: Sequence[str]) -> Table:
    """Medians over the scored frames of courses in steady light with the default camera."""
    chosen: dict[tuple[float, float], dict[str, list[tuple[float, float]]]] = {}
    for _, found in results:
        for row in found:
            course = courses.get(row["course"])
            if course is None or row["judge"] != SHOWN[0] or row["policy"] not in policies or "time_us" not in row:
                continue
            if course.light == "steady" and course.kind == "default":
                by_policy = chosen.setdefault((course.lux, course.speed_px), {})
                by_policy.setdefault(row["policy"], []).append((row["time_us"], row["gain_db"]))
    rows = []
    for (lux, speed_px), by_policy in sorted(chosen.items()):
        middles = [np.median(by_policy[policy], axis=0) for policy in policies]
        rows.append([f"{lux:g} lux, {speed_px:g} px", *(f"{t / 1e3:.2f} ms, {g:.0f} dB" for t, g in middles)])
    caption = (
        "Settings chosen in steady light: medians over frames and courses, by light and image speed (pixels of the 360 "
        f"wide frame per 1/60 s). `{FIXED_IN_HINDSIGHT}`: those chosen by `{SHOWN[0]}`."
    )
    return Table(caption, ["light and speed", *(f"`{policy}`" for policy in policies)], rows)


WORST = 3  # Courses shown
FRAMES = 5  # Shown of each, spread over what is scored
# Added to matches, and to errors in pixels: a ratio of two tiny values says nothing.
_LEAST = {"higher": 1.0, "lower": 0.01}


def worst_courses(results: Results, verdicts: Verdicts) -> list[tuple[MatchesCourse, float]]:
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


def worst_table(worst: list[tuple[MatchesCourse, float]], verdicts: Verdicts) -> Table:
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


def plot_worst(worst: list[tuple[MatchesCourse, float]], results: Results, file: Path) -> None:
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


def _frames(course: MatchesCourse, fixed: ExposureSetting) -> tuple[list[Frame], list[Frame]]:
    film = course.film()
    rig = MatchesRig(film, course.eyes, SCORING_SEEDS[0])
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


_MODULES = (matches_judge, odometry_judge, registration_judge)

BETTER: dict[str, Literal["higher", "lower"]] = {
    judge: better for module in _MODULES for judge, better in module.JUDGES.items()
}


def verdicts_of(results: Results) -> Verdicts:
    """What all judges found."""

    def rows() -> Iterator[dict[str, Any]]:
        for _, found in results:
            yield from found

    return Verdicts(rows(), BETTER)


def section(results: Results, folder: Path, *, name: str = "worth") -> ReportSection:
    """Whether the default is inferior to anyone, the means of all, and where it loses most."""
    verdicts = verdicts_of(results)
    plot_gains(verdicts, folder / f"{name}.png")
    figure = Figure(
        f"{name}.png",
        "How much better than the default each policy is, with 95 % intervals over pictures, rooms or parks: green "
        "where the whole interval is above 0, orange where it is below.",
    )
    worst = worst_courses(results, verdicts)
    plot_worst(worst, results, folder / f"{name}_worst.png")
    ours = [one.name for one in OURS]
    rivals = [one for one in verdicts.policies if one not in {*NOT_COUNTED, *ours}]
    parts: list[Table | Figure] = [
        *claims_tables(verdicts, rivals),
        figure,
        *means_tables(verdicts),
        *matches_tables(results, verdicts, rivals, ours),
        worst_table(worst, verdicts),
        Figure(f"{name}_worst.png", "Frames of these courses: number, exposure time and gain."),
    ]
    setting = text_beside(
        __file__, rooms=ROOMS, seconds=SECONDS, kinds=len(LUX), worst_mm=WORST_MM, error_margin=ERROR_MARGIN,
        feature_margin=FEATURE_MARGIN, tried=len(TRIED_STOPS), apart_stops=TRIED_STOPS[1] - TRIED_STOPS[0],
        longest_ms=LONGEST_US / 1e3,
    )  # fmt: skip
    return ReportSection(f"{setting}\n\n{_pictures(results)}", [], parts)


def data(results: Results) -> Plain:
    """For `--json`: every policy on the same courses of a judge."""
    return verdicts_of(results).plain()


def _pictures(results: Results) -> str:
    """Which pictures were used."""
    names = dict.fromkeys(course.scene for course in courses_of(results).values())
    photographs = [name.rpartition("/")[2].removesuffix(".hdr") for name in names if ":" not in name]
    painted = [name for name in names if ":" in name]
    return (
        f"Photographs: {', '.join(photographs) or 'none found'}. Painted stills (painter:seed): {', '.join(painted)}."
    )


def jobs(quick: bool) -> list[Job]:
    """The jobs of all judges, on the scenes of the report; a quick run, which anyone may make, opens none of them."""
    return tuning_jobs(quick) if quick else [job for module in _MODULES for job in module.jobs_of("report", quick)]


def tuning_jobs(quick: bool) -> list[Job]:
    """The same on the scenes that may be tuned on."""
    return [job for module in _MODULES for job in module.jobs_of("tuning", quick)]


EXPERIMENT = Experiment("worth", "What a frame is worth to localization: judges of all policies", jobs, section, data)

TUNING = Experiment(
    "worth-tuning", "The same judges on the scenes that may be tuned on", tuning_jobs,
    partial(section, name="worth-tuning"), data, in_all=False,
)  # fmt: skip
