"""The command `autoexpose rejudge`, and the page that it writes."""

from __future__ import annotations

import base64
import json
import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import typer
from rich.console import Console
from rich.table import Table

from autoexpose_daemon.control.policies.ids import POLICY_IDS, check_policy_id
from documents.files import check_writable
from documents.text import readable
from evaluation.arrays import Greys
from evaluation.long_runs import LongProgress
from evaluation.pool import over_processes
from evaluation.rejudge.contest import Figures, Outcome, Round, document, first_setting, follow_best_shots, play
from evaluation.rejudge.drive import Drive
from evaluation.rejudge.following import IN_HOUSE, ReferenceTrajectory, Trajectory, check_odometry, read_tum
from evaluation.rejudge.sources import read_folder, read_recording
from imaging.errors import AutoexposeError, ConfigurationError

WIDTH = 240  # Of a picture, pixels


def write_report(drive: Drive, outcomes: Sequence[Outcome], result: Mapping[str, Any], page: Path) -> None:
    """Write the page; an existing one is replaced. `result`: as `contest.document` returns it. Raises AutoexposeError
    when it cannot be written, or packages are missing."""
    try:
        import jinja2  # noqa: PLC0415  an extra, which only reports need
    except ImportError as error:
        raise AutoexposeError("jinja2 is missing: pip install 'autoexpose-daemon[calibration]'") from error
    loaders = [jinja2.PackageLoader(package, "") for package in ("evaluation.rejudge", "calibration.report")]
    environment = jinja2.Environment(loader=jinja2.ChoiceLoader(loaders), autoescape=True)
    rows = [
        {
            "figures": outcome.figures,
            "pictures": [
                {"jpeg": _jpeg(picture), "caption": caption}
                for picture, caption in zip(outcome.pictures, outcome.captions, strict=True)
            ],
        }
        for outcome in outcomes
    ]
    text = environment.get_template("report.html").render(
        title=f"Policies on {Path(drive.name).name}", drive=drive, rows=rows, **result
    )
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise AutoexposeError(f"{page} cannot be written: {readable(str(error.strerror))}") from error


def _jpeg(picture: Greys) -> str:
    height = round(WIDTH * picture.shape[0] / picture.shape[1])
    small = cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA)
    return base64.b64encode(cv2.imencode(".jpg", small)[1].tobytes()).decode()


SIDE_BY_SIDE = 3  # Policies in one round: reading is shared, and progress still shows


def rejudge(
    drive: Annotated[Path, typer.Argument(help="A recording by `record --bracket`, or a folder of images.")],
    *,
    policies: Annotated[str, typer.Option(help="Ids, separated by commas; or `all`.")] = "all",
    odometry: Annotated[
        str, typer.Option(help="`in-house`, `orbslam3`, or a command that gets a folder and writes a trajectory.")
    ] = IN_HOUSE,
    trajectory: Annotated[
        Path | None, typer.Option(help="The true trajectory in TUM's format; by default that on the best shots.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this JSON file.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page with pictures to this HTML file.")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = len(os.sched_getaffinity(0)),
) -> None:
    """Take policies through a drive that was recorded in brackets, and say which one serves the robot best."""
    chosen = _chosen(policies)
    check_odometry(odometry)
    for file, option, suffix in ((json_file, "--json", ".json"), (report, "--report", ".html")):
        if file is not None:
            if file.suffix != suffix:  # so that no drive, trajectory or configuration is ever replaced
                raise ConfigurationError(f"{option} {file}: name a {suffix} file")
            check_writable(file)
    truth = None if trajectory is None else read_tum(trajectory)
    console = Console()
    with console.status(f"reading {drive} ..."):
        recorded = read_folder(drive) if drive.is_dir() else read_recording(drive)
    _print_drive(recorded, console)
    with tempfile.TemporaryDirectory(prefix="autoexpose-rejudge-") as folder:
        if truth is None:
            with console.status("following the camera on the best shots ..."):
                truth = follow_best_shots(recorded, odometry, Path(folder))
        else:
            _check_fits(truth, recorded, trajectory)
        reference = None if truth is None else ReferenceTrajectory.of(truth, recorded.timeline.cycle_s)
        outcomes = _play(Round(recorded, chosen, odometry, reference, Path(folder)), jobs, console)
    figures = [outcome.figures for outcome in outcomes]
    limits = recorded.setup.limits
    result = document(figures, limits, first_setting(recorded))
    _print(figures, result["recommended"], console)
    if all(one.rpe_mm is None and not one.matches for one in figures):
        console.print("recommended by M_g alone, since nothing was matched", highlight=False)
    console.print(f"recommended for this drive, to paste into the configuration:\n\n{result['section']}", markup=False)
    if json_file is not None:
        json_file.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if report is not None:
        write_report(recorded, outcomes, result, report)
        console.print(f"report: {report}")


def _chosen(policies: str) -> list[str]:
    """The requested ids, each once."""
    if policies == "all":
        return list(POLICY_IDS)
    chosen = list(dict.fromkeys(policies.split(",")))
    for policy in chosen:
        check_policy_id(policy)
    return chosen


def _check_fits(truth: Trajectory, drive: Drive, path: Path | None) -> None:
    """Raise a ConfigurationError for a trajectory of another time."""
    glimpses = drive.timeline.glimpses
    known = sum(truth.at(glimpse.time_s) is not None for glimpse in glimpses)
    if known < len(glimpses) / 2:
        raise ConfigurationError(
            f"{path}: covers {known} of the {len(glimpses)} pairs of the drive: its times are "
            f"{truth.times_s[0]:.3f} to {truth.times_s[-1]:.3f} s, those of the drive {glimpses[0].time_s:.3f} to "
            f"{glimpses[-1].time_s:.3f} s"
        )


def _print_drive(drive: Drive, console: Console) -> None:
    timeline = drive.timeline
    still = sum(timeline.still) / len(timeline.still)
    moved_px, jumps = timeline.cycle_motion_px, timeline.sections[-1]
    moved = "" if moved_px is None else f", else {moved_px:.0f} pixels to a cycle"
    console.print(
        f"{len(timeline.glimpses)} pairs in {drive.seconds:.1f} s, {timeline.cycle} to a cycle, "
        f"{drive.missing} missing; a decision shows after {drive.delay_frames} pairs; {100 * still:.0f} % at "
        f"rest{moved}; {jumps} {'jump' if jumps == 1 else 'jumps'} of the light",
        highlight=False,
    )
    if jumps > len(timeline.glimpses) / timeline.cycle / 2:
        console.print(
            "the light seems to jump in most cycles: more likely, a response is missing or wrong, and nothing below "
            "can be trusted: give cameras.left.response and cameras.right.response "
            "(`autoexpose calibrate response`), and record again",
            highlight=False,
        )
    if len(drive.geometries) < 2:
        console.print(
            "no matches and no odometry: the drive has no calibrated pair of cameras; give "
            "cameras.left.calibration and cameras.right.calibration when you record, or put left.yaml and right.yaml "
            "beside the images of a folder",
            highlight=False,
        )


def _play(everyone: Round, jobs: int, console: Console) -> list[Outcome]:
    policies = everyone.policies
    rounds = [
        replace(everyone, policies=policies[first : first + SIDE_BY_SIDE])
        for first in range(0, len(policies), SIDE_BY_SIDE)
    ]
    found: dict[str, Outcome] = {}
    try:
        with LongProgress(console, 3600.0) as progress:
            bar = progress.add_task("policies", total=len(policies))
            with closing(over_processes(play, rounds, min(jobs, len(rounds)))) as finished:
                for one, outcomes in finished:
                    found |= {outcome.figures.policy: outcome for outcome in outcomes}
                    progress.update(bar, advance=len(one.policies))
    except KeyboardInterrupt:
        raise AutoexposeError("stopped before all policies were judged: nothing was written") from None
    return [found[policy] for policy in policies]


def _print(figures: Sequence[Figures], best: str, console: Console) -> None:
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    figures_shown = [
        "RPE\nmm", "lost", "matches", "M_g", "satu-\nrated", "black", "time\nms", "gain\ndB", "far", "blur",
    ]  # fmt: skip
    for place, head in enumerate(["policy", *figures_shown]):
        table.add_column(head, justify="right" if place else "left", no_wrap=True)
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
