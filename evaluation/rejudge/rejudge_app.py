"""The command `autoexpose rejudge`."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from autoexpose_daemon.control.policies.ids import check_policy_id
from autoexpose_daemon.own_policy.installed import register_policies
from documents.files import check_writable
from evaluation.intervals import Interval
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import CLUSTER, CORES, FINISHED, KEPT, PROCESSES, workers_of
from evaluation.long_runs import make_writable
from evaluation.rejudge.contender import contenders
from evaluation.rejudge.contest import Figures
from evaluation.rejudge.decide import Difference, Margins
from evaluation.rejudge.fleet import By, JudgedDrive, JudgedFleet, found_drives, groups_of, judge
from evaluation.rejudge.following import IN_HOUSE, check_odometry, read_tum
from evaluation.rejudge.report import write_report
from imaging.errors import ConfigurationError

_MARGINS = Margins()
_NAME_WIDTH = 22  # So that figures fit beside names on a line of 80


def rejudge(
    drives: Annotated[
        list[Path],
        typer.Argument(help="Recordings by `record --bracket`, folders of images, folders of these, or lists (.txt)."),
    ],
    *,
    policies: Annotated[
        str,
        typer.Option(
            help="Ids, separated by commas, or `all`; with lower limits as belief:max_time_us=3000:max_gain_db=12."
        ),
    ] = "all",
    present: Annotated[
        str | None, typer.Option(help="What robots run now, with which others are compared: by default, what they ran.")
    ] = None,
    odometry: Annotated[
        str, typer.Option(help="`in-house`, `orbslam3`, or a command that gets a folder and writes a trajectory.")
    ] = IN_HOUSE,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="The true trajectory of a drive in TUM's format; by default that on the best shots."),
    ] = None,
    margin_odometry: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Differences of the error that you do not care about, a share of it."),
    ] = _MARGINS.odometry,
    margin_lost: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="The same of lost pairs, a share of all.")
    ] = _MARGINS.lost,
    margin_features: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="The same of matches, a share of them.")
    ] = _MARGINS.features,
    by: Annotated[By | None, typer.Option(help="Decide also for each day, robot or class of light.")] = None,
    groups: Annotated[
        Path | None, typer.Option(help="The same for groups of your own, a CSV file: drive,group.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this JSON file.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page with pictures to this HTML file.")] = None,
    jobs: PROCESSES = CORES,
    cluster: CLUSTER = None,
    kept: KEPT = FINISHED,
) -> None:
    """Take policies through drives that were recorded in brackets, and say which one robots should run."""
    register_policies()
    chosen = contenders(policies)
    if present is not None:
        check_policy_id(present)
    check_odometry(odometry)
    for file, option, suffix in ((json_file, "--json", ".json"), (report, "--report", ".html")):
        if file is not None:
            if file.suffix != suffix:  # so that no drive, trajectory or configuration is ever replaced
                raise ConfigurationError(f"{option} {file}: name a {suffix} file")
            check_writable(file)
    found = found_drives(drives)
    if trajectory is not None:
        if len(found) > 1:
            raise ConfigurationError("--trajectory is of one drive: give one drive")
        read_tum(trajectory)
    make_writable(kept, "--kept")
    console = Console()
    judgement = judge(
        found, chosen, present=present, by=by, groups={} if groups is None else groups_of(groups), odometry=odometry,
        trajectory=trajectory, margins=Margins(margin_odometry, margin_lost, margin_features), kept=ResultCache(kept),
        workers=workers_of(jobs, cluster), console=console,
    )  # fmt: skip
    _show(judgement, console)
    if json_file is not None:
        json_file.write_text(json.dumps(judgement.document(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if report is not None:
        write_report(judgement, report)
        console.print(f"report: {report}")


def _show(judgement: JudgedFleet, console: Console) -> None:
    for sentence in judgement.refused:
        console.print(f"left out: {sentence}", highlight=False, markup=False)
    for drive in judgement.drives:
        _print_drive(drive, judgement.present, console)
    _print(judgement.figures(), judgement.decision().policy or judgement.present, console)
    _print_differences(judgement.differences(), judgement.present, console)
    for group in judgement.groups:
        console.print(f"{group}: {judgement.decision(group).why}", highlight=False, markup=False)
    console.print(f"\n{judgement.decision().why}", highlight=False, markup=False)
    console.print(f"for the configuration:\n\n{judgement.section}", highlight=False, markup=False)


def _print_drive(drive: JudgedDrive, present: str, console: Console) -> None:
    abouts = [result["about"] for result in drive.results[present]]
    pairs, cycle = sum(about["pairs"] for about in abouts), abouts[0]["cycle"]
    still = sum(about["still_share"] * about["pairs"] for about in abouts) / pairs
    moving = [about["cycle_motion_px"] for about in abouts if about["cycle_motion_px"] is not None]
    moved = f", else {sum(moving) / len(moving):.0f} pixels to a cycle" if moving else ""
    jumps = sum(about["jumps"] for about in abouts)
    console.print(
        f"{drive.path.name}: {pairs} pairs in {drive.seconds:.1f} s, {cycle} to a cycle, "
        f"{sum(about['missing'] for about in abouts)} missing; "
        f"a decision shows after {abouts[0]['delay_frames']} pairs; {100 * still:.0f} % at rest{moved}; "
        f"{jumps} {'jump' if jumps == 1 else 'jumps'} of the light",
        highlight=False, markup=False,
    )  # fmt: skip
    if jumps > pairs / cycle / 2:
        console.print(
            "the light seems to jump in most cycles: more likely, a response is missing or wrong, and nothing below "
            "can be trusted: give cameras.left.response and cameras.right.response "
            "(`autoexpose calibrate response`), and record again",
            highlight=False,
        )
    if not abouts[0]["calibrated"]:
        console.print(
            "no matches and no odometry: the drive has no calibrated pair of cameras; give "
            "cameras.left.calibration and cameras.right.calibration when you record, or put left.yaml and right.yaml "
            "beside the images of a folder",
            highlight=False,
        )


def _print_differences(found: Sequence[Difference], present: str, console: Console) -> None:
    if not found:
        return
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    _add_names(table, f"better than {present} by", [one.policy for one in found])
    for name in ("error", "lost pairs", "matches"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in found:
        table.add_row(one.policy, _interval(one.odometry), _interval(one.lost), _interval(one.features))
    console.print(table)
    console.print("in %, with intervals of 95 %, paired by segments of ten seconds", highlight=False)


def _add_names(table: Table, head: str, names: Sequence[str]) -> None:
    """The first column; long names go on in the next line."""
    width = min(max(len(each) for each in (head, *names)), _NAME_WIDTH)
    table.add_column(head, min_width=width, max_width=width, overflow="fold")


def _interval(interval: Interval | None) -> str:
    if interval is None or not math.isfinite(interval.high - interval.low):
        return "-" if interval is None else f"{100 * interval.value:+.1f} [?]"
    value, low, high = (f"{max(100 * each, -999.0):+.1f}" for each in (interval.value, interval.low, interval.high))
    return f"{value} \\[{low}, {high}]"


def _print(figures: Sequence[Figures], best: str, console: Console) -> None:
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    figures_shown = [
        "RPE\nmm", "lost", "matches", "M_g", "satu-\nrated", "black", "time\nms", "gain\ndB", "far", "blur",
    ]  # fmt: skip
    _add_names(table, "policy", [one.policy for one in figures])
    for head in figures_shown:
        table.add_column(head, justify="right", no_wrap=True)
    for one in sorted(figures, key=_rank):
        table.add_row(
            f"[bold]{one.policy}[/]" if one.policy == best else one.policy,
            _number(one.rpe_mm, 2), _percent(one.lost_share), _number(one.matches, 0), f"{one.metric:.3f}",
            _percent(one.saturated_share), _percent(one.black_share), f"{one.exposure_time_us / 1e3:.2f}",
            f"{one.gain_db:.1f}", _percent(one.far_share), f"x{one.blur_ratio:.1f}",
        )  # fmt: skip
    console.print(table)
    console.print(
        "far: pairs for which the bracket has no shot within a stop; blur: how much longer the shots were exposed than "
        "the frames they stand for, which cannot be removed",
        highlight=False,
    )


def _rank(one: Figures) -> tuple[float, float, float]:
    return (one.rpe_mm if one.rpe_mm is not None else math.inf, -(one.matches or 0.0), -one.metric)


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f} %"
