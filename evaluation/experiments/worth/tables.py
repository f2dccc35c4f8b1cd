"""What judges say, over courses: means with their intervals, and the default policy compared with all others."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.committed import ERROR_MARGIN, FEATURE_MARGIN
from evaluation.drawing import COLOURS, panels, save
from evaluation.experiments.experiment import Table
from evaluation.intervals import FEWEST, Interval, PolicyComparison, over_places

FIXED_IN_HINDSIGHT = "fixed-in-hindsight"
ORACLE_PER_FRAME = "oracle-per-frame"
BOUNDS = (FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME)
NOT_COUNTED = ("fixed", *BOUNDS)  # What knows the course, and `fixed`, which was chosen by hand for rooms like these


MARGINS = {
    "odometry-raw": ERROR_MARGIN, "odometry-preprocessed": ERROR_MARGIN, "matches-orb-raw": FEATURE_MARGIN,
    "matches-orb-preprocessed": FEATURE_MARGIN, "matches-sift-raw": FEATURE_MARGIN, "lost-pairs-raw": ERROR_MARGIN,
    "bad-frames": ERROR_MARGIN, "fig12 (a)": ERROR_MARGIN, "fig12 (b)": ERROR_MARGIN,
}  # fmt: skip
"""The judges by which a policy is inferior or not, most important first, and by how much it may be worse."""

FAILURES = "odometry-failures"  # Its values are compared as they are, since most are 0
_FEW = f"Of fewer than {FEWEST} places it is Student's interval."
_COLUMNS = 6  # Judges side by side in one table
Better = Mapping[str, Literal["higher", "lower"]]


class Verdicts:
    """The values of all judges, by course and policy. `rows`: {judge, course, policy, value, ...}; of judges whose
    values are errors of runs also {failed}. `better`: which values of each judge are better. Raises ValueError when no
    course of a judge is one of all its policies, or a value is not a number."""

    def __init__(self, rows: Iterable[Mapping[str, Any]], better: Better) -> None:
        self.better = better
        self._comparisons: dict[tuple[str, str, str], PolicyComparison | None] = {}
        self._failed: dict[str, set[tuple[str, str]]] = {}
        self._values: dict[str, dict[str, dict[str, float]]] = {judge: {} for judge in better}
        for row in rows:
            self._values[row["judge"]].setdefault(row["policy"], {})[row["course"]] = float(row["value"])
            if "failed" in row:
                failed = self._failed.setdefault(row["judge"], set())
                failed |= {(row["policy"], row["course"])} if row["failed"] else set()
        for judge, by_policy in self._values.items():
            if by_policy and not self.courses(judge, *by_policy):
                raise ValueError(f"{judge}: its policies have no course in common")
            if not all(math.isfinite(value) for by_course in by_policy.values() for value in by_course.values()):
                raise ValueError(f"{judge}: a value is not a finite number")

    @property
    def judges(self) -> list[str]:
        """Those with results."""
        return [judge for judge, by_policy in self._values.items() if by_policy]

    @property
    def policies(self) -> list[str]:
        """In the order of their first results."""
        return list(dict.fromkeys(policy for judge in self.judges for policy in self._values[judge]))

    def courses(self, judge: str, *policies: str) -> list[str]:
        """Those that all of these policies have, in one order; none if this judge has not seen one of them."""
        return sorted(set.intersection(*(set(self._values[judge].get(policy, ())) for policy in policies)))

    def mean(self, judge: str, policy: str, courses: Iterable[str]) -> float:
        """Mean of some courses."""
        return float(np.mean([self._values[judge][policy][course] for course in courses]))

    def average(self, judge: str, policy: str) -> Interval | None:
        """Mean of a policy over the courses of all; of errors the geometric mean of the runs that did not fail."""
        by_course = self._values[judge].get(policy)
        if by_course is None:
            return None
        courses = self.courses(judge, *self._values[judge])
        if judge not in self._failed:
            return over_places([by_course[course] for course in courses], _places(courses))
        kept = [course for course in courses if (policy, course) not in self._failed[judge]]
        if not kept:
            return None
        logs = over_places([math.log(by_course[course]) for course in kept], _places(kept))
        return Interval(math.exp(logs.value), math.exp(logs.low), math.exp(logs.high))

    def compare(self, judge: str, policy: str, other: str) -> PolicyComparison | None:
        """How much worse a policy is than another, on the courses of both; None where a judge has not seen both."""
        key = (judge, policy, other)
        if key not in self._comparisons:
            self._comparisons[key] = self._compare(*key)
        return self._comparisons[key]

    def _compare(self, judge: str, policy: str, other: str) -> PolicyComparison | None:
        if not (courses := self.courses(judge, policy, other)):
            return None
        own, others = (np.array([self._values[judge][one][course] for course in courses]) for one in (policy, other))
        if judge in self._failed:
            failed = [any((one, course) in self._failed[judge] for one in (policy, other)) for course in courses]
            return PolicyComparison.of_errors(own, others, np.array(failed), _places(courses))
        losses = own - others if self.better[judge] == "lower" else others - own
        # Something that never happened to the other has no share that it could be compared with.
        base = None if judge == FAILURES or not others.any() else others
        return PolicyComparison.of_means(losses, base, _places(courses))

    def among(self, courses: Collection[str]) -> Verdicts:
        """The same on some of the courses."""
        rows: list[dict[str, Any]] = self.plain()["results"]
        return Verdicts((row for row in rows if row["course"] in courses), self.better)

    def plain(self) -> dict[str, Any]:
        """For `--json`."""
        results: list[dict[str, Any]] = [
            {"judge": judge, "course": course, "policy": policy, "value": value}
            | ({"failed": (policy, course) in self._failed[judge]} if judge in self._failed else {})
            for judge in self.judges
            for policy, by_course in self._values[judge].items()
            for course, value in by_course.items()
        ]
        better: dict[str, Any] = {judge: self.better[judge] for judge in self.judges}
        return {"default_policy": DEFAULT_POLICY, "better": better, "results": results}


def _places(courses: Sequence[str]) -> list[str]:
    """The picture, room or park of each course: several courses may share one."""
    return [course.partition(",")[0] for course in courses]


def means_tables(verdicts: Verdicts) -> list[Table]:
    """Mean of each judge and policy, with its interval over the courses' pictures, rooms or parks."""

    def cell(judge: str, policy: str) -> str:
        average = verdicts.average(judge, policy)
        return "-" if average is None else average.text(_form(average.value))

    caption = (
        f"Mean over the courses of all, [95 % interval over their pictures, rooms or parks]. {_FEW} "
        "Errors of odometry: geometric mean over the runs that did not fail."
    )
    return _tables(verdicts, caption, cell)


def claims_tables(verdicts: Verdicts, rivals: Sequence[str], subject: str = DEFAULT_POLICY) -> list[Table]:
    """Whether a policy is inferior to each rival, by the judges that decide; then those who are only shown."""
    judges = [judge for judge in MARGINS if judge in verdicts.judges]
    rivals = [
        *(one for one in rivals if one not in NOT_COUNTED),
        *(one for one in NOT_COUNTED if one in verdicts.policies),
    ]

    def claim(judge: str, rival: str) -> str:
        found = verdicts.compare(judge, subject, rival)
        if found is None:
            return "-"
        verdict = "" if rival in NOT_COUNTED else f", {found.noninferior(MARGINS[judge])}"
        courses = len(verdicts.courses(judge, subject, rival))
        few = f" ({courses} courses)" if courses < len(verdicts.courses(judge, subject)) else ""
        return f"{_percent(found.narrow)} ± {100 * found.seen:.1f}{verdict}{few}"

    rows = [[f"`{rival}`", *(claim(judge, rival) for judge in judges)] for rival in rivals]
    heads = ["compared with", *(f"`{judge}`, margin {MARGINS[judge]:.0%}" for judge in judges)]
    caption = (
        f"How much worse `{subject}` is than each other, in %, [90 % interval over pictures or rooms], ± the smallest "
        "difference that could have been seen. Not inferior: worse by less than the margin, with 95 % confidence; "
        "better: the whole 95 % interval is below 0. Errors of odometry: geometric mean of the ratio over the rooms in "
        f"which neither failed. {', '.join(f'`{one}`' for one in NOT_COUNTED)} are shown, and count for nothing."
    )
    return [Table(caption, heads, rows), *_failures_table(verdicts, rivals, subject)]


def _failures_table(verdicts: Verdicts, rivals: Sequence[str], subject: str) -> list[Table]:
    rows = []
    for rival in rivals:
        apart = verdicts.compare(FAILURES, subject, rival) if FAILURES in verdicts.judges else None
        if apart is not None:
            shares = [verdicts.average(FAILURES, policy) for policy in (subject, rival)]
            pairs = [verdicts.compare(judge, subject, rival) for judge in MARGINS if judge.startswith("odometry")]
            rows.append([
                f"`{rival}`", *(f"{100 * one.value:.1f}" for one in shares if one), _percent(apart.worse),
                *(str(one.left_out) for one in pairs if one),
            ])  # fmt: skip
    heads = [
        "compared with", f"`{subject}` failed, %", "it failed, %", "difference [95 %]", "left out, raw", "preprocessed",
    ]  # fmt: skip
    caption = (
        "Runs of odometry that failed, and rooms in which one of both did, which the comparison of errors leaves out."
    )
    return [Table(caption, heads, rows)] if rows else []


def _gain(verdicts: Verdicts, judge: str, policy: str) -> Interval | None:
    found = verdicts.compare(judge, policy, DEFAULT_POLICY)
    return Interval(-found.worse.value, -found.worse.high, -found.worse.low) if found else None


def plot_gains(verdicts: Verdicts, file: Path) -> None:
    """How much better than the default each policy is: a panel for each judge."""
    judges, policies = verdicts.judges, [policy for policy in verdicts.policies if policy != DEFAULT_POLICY]
    across = min(4, len(judges))
    down = math.ceil(len(judges) / across)
    figure, grid = panels(down, across, 0.8 + down * (0.6 + 0.15 * len(policies)), sharey=True, squeeze=False)
    for place, axes in enumerate(grid.ravel()):
        if place >= len(judges):
            axes.set_visible(False)
            continue
        _draw_judge(axes, verdicts, judges[place], policies)
    figure.supxlabel(f"better than {DEFAULT_POLICY} by % of its mean", fontsize=9)
    save(figure, file)


def _draw_judge(axes: Any, verdicts: Verdicts, judge: str, policies: Sequence[str]) -> None:
    known = [(row, gain) for row, policy in enumerate(policies) if (gain := _gain(verdicts, judge, policy)) is not None]
    rows, colours = [row for row, _ in known], [_colour(gain) for _, gain in known]
    middles, lows, highs = (100 * np.array([(gain.value, gain.low, gain.high) for _, gain in known])).T
    axes.hlines(rows, lows, highs, colors=colours, linewidth=1.2)
    axes.scatter(middles, rows, c=colours, s=8)
    axes.axvline(0.0, color="grey", linewidth=0.8)
    axes.set_xscale("symlog", linthresh=10)
    axes.set_title(judge, fontsize=7)
    axes.tick_params(labelsize=6)
    axes.set_yticks(range(len(policies)), policies)
    axes.set_ylim(len(policies) - 0.5, -0.5)


def _colour(gain: Interval) -> str:
    """Green: better, orange: worse, each with the whole interval."""
    return COLOURS[2] if gain.low > 0 else COLOURS[1] if gain.high < 0 else COLOURS[6]


def _tables(verdicts: Verdicts, caption: str, cell: Any) -> list[Table]:
    tables = []
    for first in range(0, len(verdicts.judges), _COLUMNS):
        judges = verdicts.judges[first : first + _COLUMNS]
        rows = [[f"`{policy}`", *(cell(judge, policy) for judge in judges)] for policy in verdicts.policies]
        heads = ["policy", *(f"`{judge}` ({verdicts.better[judge]} is better)" for judge in judges)]
        tables.append(Table(caption, heads, rows))
    return tables


def _form(value: float) -> str:
    return ".0f" if abs(value) >= 20 else ".2f" if abs(value) >= 0.1 else ".3f"


def _percent(gain: Interval) -> str:
    return Interval(100 * gain.value, 100 * gain.low, 100 * gain.high).text("+.1f")
