"""What only the judge of matches can say: results on hard courses, and the settings that contenders chose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import Results, Table
from evaluation.experiments.worth.matches.courses import Course
from evaluation.experiments.worth.matches.scenes import is_panorama
from evaluation.experiments.worth.matches.scoring import JUDGES
from evaluation.experiments.worth.names import FIXED_IN_HINDSIGHT
from evaluation.experiments.worth.tables import Verdicts, claims_tables

SHOWN = ("matches-orb-raw", "matches-orb-preprocessed", "pose-error-orb-raw", "klt-error-raw", "klt-error-preprocessed")
"""Of the judges, where the default loses most."""


def matches_tables(
    results: Results, verdicts: Verdicts, rivals: Sequence[str], settings_of: Sequence[str]
) -> list[Table]:
    """Whether the default is inferior on hard courses, and the settings that contenders chose."""
    courses = courses_of(results)
    return [
        *_claims(verdicts, courses, [*rivals, *settings_of]),
        _settings(results, courses, [*settings_of, FIXED_IN_HINDSIGHT]),
    ]


def _claims(verdicts: Verdicts, courses: Mapping[str, Course], rivals: Sequence[str]) -> list[Table]:
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


def courses_of(results: Results) -> dict[str, Course]:
    """The courses of this judge's jobs, by name; those of other judges have another form."""
    mine = [arguments for arguments, found in results if found and found[0]["judge"] in JUDGES]
    courses = [Course(**arguments["course"]) for arguments in mine if isinstance(arguments["course"], dict)]
    return {course.name: course for course in courses}


def _settings(results: Results, courses: Mapping[str, Course], policies: Sequence[str]) -> Table:
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
