"""The page of `autoexpose rejudge`: what to run, how sure that is, and where each policy fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from documents.text import readable
from evaluation.intervals import Interval
from evaluation.rejudge.decide import LEAST_MM, Difference
from evaluation.rejudge.fleet import JudgedDrive, JudgedFleet
from imaging.errors import AutoexposeError

SHOWN_DRIVES = 20  # More of them are folded away
REACH = 0.4  # The axis of differences goes so far to both sides, as a share
LOWEST = -9.99  # Shares below are not told apart
SPAN_STOPS = 4.0  # Heights of drawn exposures are at least this


@dataclass(frozen=True, slots=True)
class Bar:
    """An interval on the axis of differences, in % of its width; None where it is not known."""

    label: str
    text: str
    low: float
    value: float
    high: float
    side: str  # "better", "worse" or "open"


@dataclass(frozen=True, slots=True)
class DriveRow:
    """What a drive says by itself."""

    name: str
    minutes: float
    group: str
    decided: str  # what to run, to stay, or "undecided"
    differences: Sequence[Apart]


@dataclass(frozen=True, slots=True)
class Apart:
    """How much better a policy is than the present one, in what is known of it first."""

    policy: str
    text: str
    side: str  # "better", "worse" or "open"


@dataclass(frozen=True, slots=True)
class Worst:
    """The ten seconds in which a policy did worst, beside the present one in the same."""

    policy: str
    where: str
    words: str
    theirs: Sequence[dict[str, str]]
    present: Sequence[dict[str, str]]
    line: str  # of exposure levels, an SVG path
    present_line: str


def write_report(judgement: JudgedFleet, page: Path) -> None:
    """Write the page; an existing one is replaced. Raises AutoexposeError when it cannot be written, or packages are
    missing."""
    try:
        import jinja2  # noqa: PLC0415  an extra, which only reports need
    except ImportError as error:
        raise AutoexposeError("jinja2 is missing: pip install 'autoexpose-daemon[calibration]'") from error
    loaders = [jinja2.PackageLoader(package, "") for package in ("evaluation.rejudge", "calibration.report")]
    environment = jinja2.Environment(loader=jinja2.ChoiceLoader(loaders), autoescape=True)
    names = [drive.path.name for drive in judgement.drives]
    text = environment.get_template("report.html").render(
        title=f"Policies on {names[0]}" if len(names) == 1 else f"Policies on {len(names)} drives",
        judgement=judgement, decision=judgement.decision(), figures=judgement.figures(),
        rows=[(one.policy, _bars(one)) for one in judgement.differences()],
        drives=[_row(judgement.of(drive)) for drive in judgement.drives], shown_drives=SHOWN_DRIVES,
        groups=[(group, judgement.decision(group)) for group in judgement.groups],
        worst=[worst for policy in judgement.policies if (worst := _worst(judgement, policy)) is not None],
        minutes=sum(drive.seconds for drive in judgement.drives) / 60.0, reach=100 * REACH,
    )  # fmt: skip
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise AutoexposeError(f"{page} cannot be written: {readable(str(error.strerror))}") from error


def _row(alone: JudgedFleet) -> DriveRow:
    """Of a fleet of one drive."""
    (drive,), made = alone.drives, alone.decision()
    decided = f"run {made.policy}" if made.policy else "stay" if made.more_minutes is None else "undecided"
    apart = [_apart(one) for one in alone.differences()]
    return DriveRow(drive.path.name, drive.seconds / 60.0, drive.group, decided, apart)


def _apart(one: Difference) -> Apart:
    if not one.known:
        return Apart(one.policy, "?", "open")
    name, interval = one.known[0]
    low, high = (f"{100 * max(each, LOWEST):+.0f}" for each in (interval.low, interval.high))
    unit = {"odometry": "error", "lost": "lost pairs", "features": "matches"}[name]
    return Apart(one.policy, f"{100 * interval.value:+.0f} % [{low}, {high}] {unit}", _side(interval))


def _side(interval: Interval) -> str:
    return "better" if interval.low > 0 else "worse" if interval.high < 0 else "open"


def _bars(one: Difference) -> list[Bar]:
    named = [("error", one.odometry), ("lost pairs", one.lost), ("matches", one.features)]
    return [_bar(name, interval) for name, interval in named if interval is not None]


def _bar(name: str, interval: Interval) -> Bar:
    low, value, high = (
        50.0 + 50.0 * min(max(each / REACH, -1.0), 1.0) for each in (interval.low, interval.value, interval.high)
    )
    return Bar(name, f"{100 * interval.value:+.1f} %", low, value, high, _side(interval))


def _worst(judgement: JudgedFleet, policy: str) -> Worst | None:
    """By the error beside the present policy's, or by lost pairs or matches where there is none."""
    if policy == judgement.present:
        return None
    found = [
        (_badness(ours["figures"], theirs["figures"]), drive, number, ours, theirs)
        for drive in judgement.drives
        for number, (ours, theirs) in enumerate(
            zip(drive.results[policy], drive.results[judgement.present], strict=True)
        )
    ]
    _, drive, number, ours, theirs = max(found, key=lambda entry: entry[0])
    levels = [*ours["levels"], *theirs["levels"]]
    middle, span = (max(levels) + min(levels)) / 2, max(max(levels) - min(levels), SPAN_STOPS)
    return Worst(
        policy, _where(drive, number, ours), f"{_words(ours['figures'])}; {judgement.present}: "
        f"{_words(theirs['figures'])}", _pictures(ours), _pictures(theirs),
        _path(ours["levels"], middle, span), _path(theirs["levels"], middle, span),
    )  # fmt: skip


def _badness(ours: dict[str, Any], theirs: dict[str, Any]) -> tuple[float, float, float]:
    own_mm, other_mm = ours["rpe_mm"], theirs["rpe_mm"]
    ratio = 1.0 if own_mm is None or other_mm is None else max(own_mm, LEAST_MM) / max(other_mm, LEAST_MM)
    return (ours["lost_share"] or 0.0) - (theirs["lost_share"] or 0.0) + ratio, ratio, -(ours["matches"] or 0.0)


def _where(drive: JudgedDrive, number: int, result: Any) -> str:
    begin_s = sum(each["about"]["seconds"] for each in next(iter(drive.results.values()))[:number])
    return f"{drive.path.name}, from {begin_s:.0f} to {begin_s + result['about']['seconds']:.0f} s"


def _words(figures: dict[str, Any]) -> str:
    said = []
    if figures["rpe_mm"] is not None:
        said.append(f"{figures['rpe_mm']:.2f} mm")
    if figures["lost_share"] is not None:
        said.append(f"{100 * figures['lost_share']:.0f} % lost")
    if figures["matches"] is not None:
        said.append(f"{figures['matches']:.0f} matches")
    return ", ".join(said) or f"M_g {figures['metric']:.3f}"


def _pictures(result: Any) -> list[dict[str, str]]:
    return [
        {"jpeg": jpeg, "caption": caption} for jpeg, caption in zip(result["pictures"], result["captions"], strict=True)
    ]


def _path(levels: Sequence[float], middle: float, span: float) -> str:
    """In a box of 100 by 24."""
    step = max(len(levels) // 300, 1)
    points = [
        f"{100 * place / max(len(levels) - 1, 1):.1f},{12 - 22 * (level - middle) / span:.1f}"
        for place, level in list(enumerate(levels))[::step]
    ]
    return "M" + " L".join(points)
