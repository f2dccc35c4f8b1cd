"""What judges say, over courses: means with their intervals, and paired differences to the default policy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.drawing import COLOURS, panels, save
from evaluation.experiments.experiment import Plain, Table
from evaluation.experiments.statistics import FEWEST, Interval, over_places

BEYOND = 0.02
"""A difference matters when its whole interval is beyond this share of the default's mean."""

_FEW = f"Of fewer than {FEWEST} places it is Student's interval."

_COLUMNS = 6
"""Judges side by side in one table."""

Better = Mapping[str, Literal["higher", "lower"]]


class Verdicts:
    """The values of all judges, by course and policy.

    Parameters
    ----------
    rows
        {judge, course, policy, value, ...}.
    better
        Which values of each judge are better.

    Raises
    ------
    ValueError
        When a policy lacks a course that others have, or a value is not a number.
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]], better: Better) -> None:
        self.better = better
        self._gains: dict[tuple[str, str], Interval | None] = {}
        self._values: dict[str, dict[str, dict[str, float]]] = {judge: {} for judge in better}
        for row in rows:
            self._values[row["judge"]].setdefault(row["policy"], {})[row["course"]] = float(row["value"])
        for judge, by_policy in self._values.items():
            courses = {frozenset(by_course) for by_course in by_policy.values()}
            if len(courses) > 1:
                raise ValueError(f"{judge}: not every policy has the same courses")
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

    def values(self, judge: str, policy: str) -> NDArray[np.float64] | None:
        """By course, in the same order for all policies; None for a policy that this judge has not seen."""
        by_policy = self._values[judge]
        if policy not in by_policy:
            return None
        return np.array([by_policy[policy][course] for course in sorted(by_policy[policy])])

    def places(self, judge: str) -> list[str]:
        """The picture, room or park of each course, in the same order: several courses may share one."""
        courses = next(iter(self._values[judge].values()))
        return [course.partition(",")[0] for course in sorted(courses)]

    def mean(self, judge: str, policy: str, courses: Iterable[str]) -> float:
        """Mean of some courses."""
        return float(np.mean([self._values[judge][policy][course] for course in courses]))

    def gain(self, judge: str, policy: str) -> Interval | None:
        """How much better than the default a policy is, as a share of the default's mean, paired by course."""
        if (judge, policy) not in self._gains:
            self._gains[judge, policy] = self._gain(judge, policy)
        return self._gains[judge, policy]

    def _gain(self, judge: str, policy: str) -> Interval | None:
        own, default = self.values(judge, policy), self.values(judge, DEFAULT_POLICY)
        if own is None or default is None:
            return None
        sign = 1.0 if self.better[judge] == "higher" else -1.0
        # A default that loses nothing can only be equalled; any scale shows that.
        scale = float(default.mean()) or 1.0
        return over_places(sign * (own - default) / scale, self.places(judge))

    def plain(self) -> Plain:
        """For `--json`."""
        results: list[dict[str, Any]] = [
            {"judge": judge, "course": course, "policy": policy, "value": value}
            for judge in self.judges
            for policy, by_course in self._values[judge].items()
            for course, value in by_course.items()
        ]
        better: dict[str, Any] = {judge: self.better[judge] for judge in self.judges}
        return {"default_policy": DEFAULT_POLICY, "better": better, "results": results}


def means_tables(verdicts: Verdicts) -> list[Table]:
    """Mean of each judge and policy, with its interval over the courses' pictures, rooms or parks."""

    def cell(judge: str, policy: str) -> str:
        values = verdicts.values(judge, policy)
        if values is None:
            return "-"
        return over_places(values, verdicts.places(judge)).text(_form(float(values.mean())))

    caption = f"Mean over courses, [95 % interval over their pictures, rooms or parks]. {_FEW}"
    return _tables(verdicts, caption, cell)


def gains_tables(verdicts: Verdicts) -> list[Table]:
    """How much better than the default each policy is, paired by course."""

    def cell(judge: str, policy: str) -> str:
        gain = verdicts.gain(judge, policy)
        return "-" if gain is None or policy == DEFAULT_POLICY else _percent(gain)

    caption = (
        f"How much better than `{DEFAULT_POLICY}`, paired by course, in % of its mean; below 0: worse. "
        f"Intervals draw pictures, rooms or parks. {_FEW}"
    )
    return _tables(verdicts, caption, cell)


def better_table(verdicts: Verdicts, allowed: Sequence[str]) -> Table:
    """Those of `allowed` that are better than the default with the whole interval beyond `BEYOND`."""
    rows = [
        [f"`{judge}`", f"`{policy}`", _percent(gain)]
        for judge in verdicts.judges
        for policy in allowed
        if (gain := verdicts.gain(judge, policy)) is not None and gain.low > BEYOND
    ]
    caption = f"Better than `{DEFAULT_POLICY}`, with the whole interval beyond {BEYOND:.0%} of its mean."
    return Table(caption, ["judge", "policy", "better by %"], rows or [["nobody", "", ""]])


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
    known = [(row, gain) for row, policy in enumerate(policies) if (gain := verdicts.gain(judge, policy)) is not None]
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
    """Green: better, orange: worse, each with the whole interval beyond `BEYOND`."""
    return COLOURS[2] if gain.low > BEYOND else COLOURS[1] if gain.high < -BEYOND else COLOURS[6]


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
