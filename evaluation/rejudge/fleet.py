"""Many drives at once: found, divided into segments, gone through by every policy, and decided on."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal

from rich.console import Console

from autoexpose_daemon.control.policies.ids import check_policy_id
from documents.files import read_text
from evaluation.intervals import Interval
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import Workers, run_long
from evaluation.rejudge.contender import LimitedPolicy, unaltered
from evaluation.rejudge.contest import Figures, section
from evaluation.rejudge.decide import Difference, Margins, Recommendation, SeenSegment, decide, differences
from evaluation.rejudge.segments import parts_of, seen, segment_jobs, survey_job, together
from evaluation.rejudge.sources import LIST, Survey
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.python310 import UTC

By = Literal["day", "robot", "light"]
LIGHT_STOPS = 4.0  # Drives are as light as others if their median exposures are in the same class of so many stops
_LONGEST_BYTES = 1 << 24


def found_drives(given: Sequence[Path]) -> list[Path]:
    """Recordings and folders of images, from what the command line names: these, folders of them, or lists of them.

    Raises ConfigurationError for what names none.
    """
    drives: list[Path] = []
    for path in given:
        if path.is_dir() and not (path / LIST).exists():
            inside = sorted([*path.rglob("*.mcap"), *(each.parent for each in path.rglob(LIST))])
            if not inside:
                raise ConfigurationError(f"{path}: there is no drive in it: no .mcap file, and no {LIST}")
            drives += inside
        elif path.suffix == ".txt":
            lines = (line.strip() for line in read_text(path, _LONGEST_BYTES).splitlines())
            drives += [path.parent / line for line in lines if line and not line.startswith("#")]
        else:
            drives.append(path)
    return list(dict.fromkeys(drives))


def groups_of(file: Path) -> dict[str, str]:
    """The group of each drive by the name of its file, from CSV: ``drive,group``. Raises ConfigurationError."""
    rows = list(csv.reader(io.StringIO(read_text(file, _LONGEST_BYTES))))
    if not rows or any(len(row) != 2 for row in rows if row):
        raise ConfigurationError(f"{file}: each line must be `drive,group`")
    return {Path(drive.strip()).name: group.strip() for drive, group in (row for row in rows if row)}


@dataclass(frozen=True, slots=True, eq=False)
class JudgedDrive:
    """A drive, and what each policy did in its segments."""

    path: Path
    survey: Survey
    group: str
    results: Mapping[str, Sequence[Any]]  # by policy: those of `measure_segment`

    @property
    def seconds(self) -> float:
        """From its first pair to the last."""
        return self.survey.times_s[-1] - self.survey.times_s[0]

    def seen(self, policy: str) -> list[SeenSegment]:
        """What decides about a policy."""
        return [seen(str(self.path), number, result) for number, result in enumerate(self.results[policy])]


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFleet:
    """All drives, and what follows from them. `refused`: sentences about those that were left out."""

    drives: Sequence[JudgedDrive]
    policies: Sequence[str]
    present: str
    margins: Margins
    refused: Sequence[str]

    def seen(self, group: str | None = None) -> dict[str, list[SeenSegment]]:
        """By policy, all segments, or those of a group of drives."""
        some = [drive for drive in self.drives if group in (None, drive.group)]
        return {policy: [one for drive in some for one in drive.seen(policy)] for policy in self.policies}

    @cache  # noqa: B019  one fleet is judged in a process
    def decision(self, group: str | None = None) -> Recommendation:
        """What to run."""
        return decide(self.seen(group), self.present, self.margins)

    @cache  # noqa: B019
    def differences(self, group: str | None = None) -> list[Difference]:
        """Each policy compared with the present one; intervals of 95 %."""
        return differences(self.seen(group), self.present, 95.0)

    def of(self, drive: JudgedDrive) -> JudgedFleet:
        """A drive by itself."""
        return replace(self, drives=[drive])

    def figures(self, drives: Sequence[JudgedDrive] | None = None) -> list[Figures]:
        """Of each policy over drives, by default all."""
        some = self.drives if drives is None else drives
        return [together([one for drive in some for one in drive.results[policy]]) for policy in self.policies]

    @property
    def groups(self) -> list[str]:
        """The names of the groups of drives, if there is more than one."""
        names = sorted({drive.group for drive in self.drives})
        return names if len(names) > 1 else []

    @property
    def section(self) -> str:
        """What to put into the configuration, YAML. Limits and start only if all drives agree on them."""
        run = LimitedPolicy.of(self.decision().policy or self.present)
        abouts = [result["about"] for drive in self.drives for result in drive.results[self.present]]
        limits, start = abouts[0]["limits"], abouts[0]["start"]
        if len(self.drives) > 1 and any(about["limits"] != limits for about in abouts):
            lowered = "".join(f"  {limit}: {value:g}\n" for limit, value in run.lowered)
            return f"control:\n  policy: {run.policy_id}\n" + (f"exposure:\n{lowered}" if lowered else "")
        own = run.limits(ExposureLimits(**limits))
        return section(run.policy_id, own, own.nearest(ExposureSetting(**start)))

    def document(self) -> dict[str, Any]:
        """What is written as JSON."""
        made = self.decision()
        return {
            "policies": [asdict(one) for one in self.figures()],
            "recommended": made.policy or self.present,
            "section": self.section,
            "present": self.present,
            "decision": {"policy": made.policy, "why": made.why, "more_minutes": made.more_minutes},
            "intervals": _intervals(self.differences()),
            "groups": {
                group: asdict(self.decision(group)) | {"intervals": _intervals(self.differences(group))}
                for group in self.groups
            },
            "drives": [
                {
                    "drive": str(drive.path), "group": drive.group, "seconds": drive.seconds,
                    "segments": len(drive.results[self.present]),
                    "policies": [asdict(one) for one in self.figures([drive])],
                }
                for drive in self.drives
            ],
            "refused": list(self.refused),
        }  # fmt: skip


def _intervals(found: Sequence[Difference]) -> dict[str, Any]:
    def plain(interval: Interval | None) -> list[float | None] | None:
        if interval is None:
            return None
        return [value if abs(value) < float("inf") else None for value in (interval.value, interval.low, interval.high)]

    return {
        one.policy: {"odometry": plain(one.odometry), "lost": plain(one.lost), "features": plain(one.features)}
        for one in found
    }


def judge(
    drives: Sequence[Path],
    policies: Sequence[str],
    *,
    present: str | None,
    by: By | None,
    groups: Mapping[str, str],
    odometry: str,
    trajectory: Path | None,
    margins: Margins,
    kept: ResultCache,
    workers: Workers,
    console: Console,
) -> JudgedFleet:
    """Take policies through drives. Raises AutoexposeError in words for the user.

    `present` is what robots run now; None: what they ran when they recorded, if all ran the same.
    """
    surveys, refused = _surveyed(drives, kept, workers, console)
    present = present or _present(list(surveys.values()))
    everyone = list(dict.fromkeys([*policies, *unaltered(policies), present]))
    for path, one in surveys.items():
        _check_limits(everyone, path, one)
    asked = [(path, part) for path, one in surveys.items() for part in parts_of(one.times_s, one.fewest_pairs)]
    jobs = [
        job
        for path, part in asked
        for job in segment_jobs(path, part, everyone, odometry, trajectory, near=surveys[path].near(part[0]))
    ]
    found: list[Any] = run_long(jobs, kept, workers, console, "policies through segments")
    results: dict[Path, dict[str, list[Any]]] = {path: {policy: [] for policy in everyone} for path in surveys}
    for place, (path, _) in enumerate(asked):
        for policy, result in zip(everyone, found[place * len(everyone) :], strict=False):
            results[path][policy].append(result)
    unfollowed = {result["about"]["unfollowed"] for result in found}
    if None not in unfollowed:
        raise AutoexposeError(unfollowed.pop())
    judged = [
        JudgedDrive(path, one, groups.get(path.name, _group(one, by)), results[path]) for path, one in surveys.items()
    ]
    return JudgedFleet(judged, everyone, present, margins, refused)


def _surveyed(
    drives: Sequence[Path], kept: ResultCache, workers: Workers, console: Console
) -> tuple[dict[Path, Survey], list[str]]:
    found: list[Any] = run_long([survey_job(drive) for drive in drives], kept, workers, console, "reading drives")
    refused = [one["refused"] for one in found if "refused" in one]
    if len(refused) == len(drives):
        raise AutoexposeError("\n".join(refused))
    surveys = {drive: Survey(**one) for drive, one in zip(drives, found, strict=True) if "refused" not in one}
    return surveys, refused


def _check_limits(names: Sequence[str], path: Path, one: Survey) -> None:
    for name in names:
        try:
            LimitedPolicy.of(name).limits(ExposureLimits(**one.limits))
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from None


def _present(surveys: Sequence[Survey]) -> str:
    ran = sorted({one.policy for one in surveys})
    if len(ran) > 1:
        raise ConfigurationError(f"robots ran {' and '.join(ran)} when they recorded: say with --present which counts")
    check_policy_id(ran[0])
    return ran[0]


def _group(one: Survey, by: By | None) -> str:
    match by:
        case "day":
            return datetime.fromtimestamp(one.times_s[0], UTC).date().isoformat()
        case "robot":
            return one.robot
        case "light":
            low = LIGHT_STOPS * (one.level // LIGHT_STOPS)
            return f"exposed at {low:.0f} to {low + LIGHT_STOPS:.0f} stops"
        case None:
            return "all"
