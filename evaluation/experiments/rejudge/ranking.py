"""Whether `autoexpose rejudge` ranks policies as driving with them does, and what re-exposed frames are worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from autoexpose_daemon.control.policies.ids import PLACES
from evaluation.experiments.experiment import Claim, Experiment, Job, ReportSection, Results, Table
from evaluation.experiments.rejudge.rehearsal import measure_lap, measure_scenario, measure_still
from evaluation.odometry.tracking import Light
from evaluation.scenes.scenarios import RATE_HZ

POLICIES = tuple(PLACES)  # All: so many are alike in the error of odometry that a few of them rank by luck

LAPS: Sequence[tuple[Light, int]] = (
    ("uneven", 301), ("uneven", 302), ("uneven", 303), ("low", 304), ("low", 305), ("faint", 306),
)  # fmt: skip
SCENARIOS = ("step_up", "step_down", "tunnel", "pan", "sun_shadow", "lowlight_fast")
SCENE, SEED = "street", 310
STILL_SCENES = ("leaves", "street", "room")
FIGURES = {"metric": "M_g", "saturated_share": "saturated share", "matches": "matches", "rpe_mm": "RPE (mm)"}
WANTED_RANKING = 0.9
WANTED_RMS_GREY = 1.0
WANTED_FRAMES = 1.0
SETTLED_STOPS = 0.25  # A policy has settled when it stays this close to the level at which it ends

_SETTING = """\
A simulated drive is recorded in brackets (six shots over six stops, two frames of delay, 60 Hz) and its policies are
judged on the recording; then each policy drives the same course itself, with the same noise of the sensor. Odometry
and matches get one pair of every cycle from both: a recording shows what a policy wants only so often. Laps go through
rooms as in fig12, and are driven a third time with other noise, to show how far odometry repeats itself; scenarios are
the arena's. Rankings are compared by Spearman's correlation over the policies, of their means over all courses. The
courses were fixed before any was run; the weights in the choice of shots, and the longest exposure of a shot, were
chosen on others. Decided after a first run: that settling is judged only where the camera stands still, since
elsewhere levels follow the view, and settle nowhere; and that all policies take part. Of the first eight, six are so
alike in the error of odometry that two drives do not agree on their order either."""


def jobs(quick: bool) -> list[Job]:
    """One for each course, with all policies."""
    policies = ["neves2009", "begin2022-code"] if quick else list(POLICIES)

    def job(measure: Any, seconds: float, arguments: dict[str, Any]) -> Job:
        frames = round(seconds * RATE_HZ)
        given = {**arguments, "frames": frames, "policies": policies}
        return Job(measure, given, cost_s=4.0 * seconds * len(policies), policies=tuple(policies))

    laps, scenarios, scenes = (LAPS[:1], SCENARIOS[:1], STILL_SCENES[:1]) if quick else (LAPS, SCENARIOS, STILL_SCENES)
    return [
        *(job(measure_lap, 1.0 if quick else 7.0, {"light": light, "room": room}) for light, room in laps),
        *(
            job(measure_scenario, 1.0 if quick else 3.0, {"scenario": scenario, "scene": SCENE, "seed": SEED})
            for scenario in scenarios
        ),
        *(Job(measure_still, {"scene": scene, "seed": SEED, "frames": 28}, 5.0, policies=()) for scene in scenes),
    ]


def section(results: Results, _folder: Path) -> ReportSection:
    """Judge rankings, settling and frames."""
    courses = [(_name(case), one) for case, one in results if "policies" in case]
    stills = {str(case["scene"]): one for case, one in results if "policies" not in case}
    rankings = {figure: found for figure in FIGURES if (found := _ranking(courses, figure)) is not None}
    settled = [frames for name, one in courses if name.startswith("step") for frames in _settling(one)]
    worst_rms = max(row["rms"] for rows in stills.values() for row in rows)
    claims = [
        *(_ranks(figure, ranking, courses) for figure, ranking in rankings.items()),
        _settles(settled),
        Claim.of_this_project(
            "frames of still scenes, four stops either side of the bracket's middle, are off by at most 1 grey level "
            "rms beyond noise",
            f"{worst_rms:.2f} grey levels at worst",
            holds=worst_rms <= WANTED_RMS_GREY,
        ),
    ]
    return ReportSection(_SETTING, claims, [*(_table(courses, figure) for figure in rankings), _still_table(stills)])


def _ranks(figure: str, ranking: tuple[float, list[float]], courses: Sequence[tuple[str, Any]]) -> Claim:
    over_all, each = ranking
    repeated = _ranking(courses, figure, ("again", "driven"))
    repeats = "" if repeated is None else f"; laps driven twice: {repeated[0]:.2f} of {len(repeated[1])}"
    return Claim.of_this_project(
        f"by {FIGURES[figure]}, policies on the recording rank as on drives of their own",
        f"Spearman {over_all:.2f} for the means of {len(each)} courses; course by course "
        f"{np.median(each):.2f} in the median, {min(each):.2f} at worst{repeats}",
        holds=over_all >= WANTED_RANKING,
    )


def _settles(settled: Sequence[tuple[int, int]]) -> Claim:
    apart = np.array([abs(ours - true) for ours, true in settled] or [0])
    return Claim.of_this_project(
        "after a jump of the light, a policy settles within a frame of when it does on a drive of its own",
        f"{np.mean(apart <= WANTED_FRAMES):.0%} of {len(settled)} runs within one frame, "
        f"{np.median(apart):.0f} frames apart in the median, {apart.max():.0f} at worst",
        holds=bool(np.all(apart <= WANTED_FRAMES)),
    )


def _settling(course: Mapping[str, Any]) -> list[tuple[int, int]]:
    """For each policy, after how many frames it settles on the recording and on its own drive."""
    return [
        (_settled(one["levels"][0], course["jump"]), _settled(one["levels"][1], course["jump"]))
        for name, one in course.items()
        if name != "jump"
    ]


def _settled(levels: Sequence[float], jump: int) -> int:
    """Frames after a jump from which on a level stays where it ends."""
    off = np.abs(np.array(levels[jump:]) - levels[-1]) > SETTLED_STOPS
    return int(np.flatnonzero(off)[-1] + 1) if off.any() else 0


Kinds = tuple[str, str]


def _ranking(
    courses: Sequence[tuple[str, Any]], figure: str, kinds: Kinds = ("rejudged", "driven")
) -> tuple[float, list[float]] | None:
    """Spearman's correlation for the means over the courses that know a figure, and of each of these courses."""
    pairs = [both for _, one in courses if (both := _values(one, figure, kinds)) is not None]
    if not pairs:
        return None
    means = np.mean(pairs, axis=0)
    return _spearman(*means), [_spearman(*both) for both in pairs]


def _values(
    course: Mapping[str, Any], figure: str, kinds: Kinds = ("rejudged", "driven")
) -> tuple[list[float], list[float]] | None:
    """Of all policies, of two kinds; None where one of them is not known."""
    policies = [one for name, one in course.items() if name != "jump"]
    both: list[list[Any]] = [[one.get(kind, {}).get(figure) for one in policies] for kind in kinds]
    return None if any(value is None for values in both for value in values) else (both[0], both[1])


def _spearman(ours: Sequence[float], true: Sequence[float]) -> float:
    if min(np.ptp(ours), np.ptp(true)) == 0:
        return 0.0  # nothing is ranked
    return float(np.corrcoef(rankdata(np.round(ours, 6)), rankdata(np.round(true, 6)))[0, 1])


def _name(case: Mapping[str, Any]) -> str:
    return f"{case['light']}, room {case['room']}" if "light" in case else f"{case['scenario']}, {case['scene']}"


def _table(courses: Sequence[tuple[str, Any]], figure: str) -> Table:
    known = [(name, both) for name, one in courses if (both := _values(one, figure)) is not None]
    policies = [name for name in courses[0][1] if name != "jump"]
    digits = {"metric": 3, "saturated_share": 2, "matches": 0, "rpe_mm": 2}[figure]
    rows = [
        [f"`{policy}`", *(f"{both[0][place]:.{digits}f} / {both[1][place]:.{digits}f}" for _, both in known)]
        for place, policy in enumerate(policies)
    ]
    caption = f"{FIGURES[figure]}: on the recording / on a drive of its own."
    return Table(caption, ["policy", *(name for name, _ in known)], rows)


def _still_table(stills: Mapping[str, Any]) -> Table:
    rows = [
        [f"{scene}, {row['offset']:+.0f}", *(f"{row[key]:.2f}" for key in ("bias", "rms", "made_noise", "noise"))]
        for scene, found in stills.items()
        for row in found
    ]
    heads = ["scene, stops from the middle", "mean error", "rms beyond noise", "noise", "noise of true frames"]
    return Table("Re-exposed frames of still scenes against true ones, in grey levels.", heads, rows)


EXPERIMENT = Experiment(
    "rejudge", "Brackets: policies judged on a recording, and on drives of their own", jobs, section
)
