"""The command `autoexpose calibrate gain`."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.commands.rig import CameraMode, check_place, places_of, rig_of_config, tool
from calibration.document import CameraIdentity
from calibration.gain.file import GainFile
from calibration.gain.solve import GainCurve, GainLooks, capture_gain, solve_gain
from calibration.result import verdict
from calibration.sources.session import Session
from drivers.aravis import open_camera
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits
from imaging.gain_scale import GainScale
from imaging.python310 import UTC

MOST_NUMBERS = 1e6
"""More than any gain has; a node without bounds has all that fit into its register."""


def gain(
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The gain file; for two cameras, a folder.")],
    camera: Annotated[
        list[str] | None, typer.Option("--camera", help="Serial number; twice for left and right.")
    ] = None,
    config: Annotated[Path | None, typer.Option("-c", "--config", help="Both cameras of this configuration.")] = None,
) -> None:
    """Measure what the numbers of a gain that is not in dB mean in dB, so that the daemon can drive it."""
    console = Console(highlight=False)
    if (not camera) == (config is None):
        raise ConfigurationError("say which gain to calibrate: one of --camera and --config")
    rig = [CameraMode(serial) for serial in camera or []] if config is None else rig_of_config(config)
    refused = False
    for path, mode in places_of(rig, output, "gain").items():
        check_place(path, GainFile.load, "gain file")
        refused |= not _calibrate(path, mode, console)
    if refused:
        raise typer.Exit(1)


def _calibrate(path: Path, mode: CameraMode, console: Console) -> bool:
    """Measure one camera and write its file; False if that is refused."""
    with Session(open_camera(mode.serial, mode.setup(own_gain=True))) as session:
        who = session.description
        _check_range(who.serial, who.gain_node, session.limits)
        looks = _looks(session, console)
    node = str(who.gain_node)
    curve = solve_gain(looks)
    console.print(f"camera: {who.vendor} {who.model}, serial {who.serial}", soft_wrap=True)
    for line in _facts(node, curve):
        console.print(line, soft_wrap=True)
    for finding in curve.findings:
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True)
    judged = verdict(curve.findings)
    console.print(f"verdict: {judged}")
    if judged == "refused":
        return False
    scale = GainScale(node, tuple(map(float, curve.settings)), tuple(map(float, curve.gains_db)))
    identity = CameraIdentity(who.vendor, who.model, who.serial)
    now = datetime.now(UTC).replace(microsecond=0)
    GainFile(scale, identity, round(curve.error_db, 3), now, tool(), curve.findings).save(path)
    console.print(f"written: {path}", soft_wrap=True)
    return True


def _check_range(serial: str, node: str | None, limits: ExposureLimits) -> None:
    """Refuse a gain that cannot be stepped through."""
    low, high = limits.min_gain_db, limits.max_gain_db
    if not 0 < high - low < MOST_NUMBERS:
        raise ConfigurationError(
            f"camera {serial}: its {node} goes from {low:g} to {high:g}: a gain without a range, or without bounds, "
            "cannot be calibrated"
        )


def _facts(node: str, curve: GainCurve) -> list[str]:
    settings = f"gain: {node} {curve.settings[0]:g} to {curve.settings[-1]:g}, {len(curve.settings)} settings measured"
    if not len(curve.gains_db):
        return [settings]
    middle = len(curve.settings) // 2
    return [
        settings,
        f"in dB: 0 to {curve.gains_db[-1]:.2f}, and {curve.gains_db[middle]:.2f} at {curve.settings[middle]:g}",
        f"error: {curve.error_db:.2f} dB at most, between the settings as well",
    ]


def _looks(session: Session, console: Console) -> GainLooks:
    serial = session.description.serial
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("left"), TimeRemainingColumn())
    try:
        with Progress(*columns, console=console, speed_estimate_period=60.0) as progress:
            bar = progress.add_task(f"camera {serial}", total=None)
            return capture_gain(session, lambda done, total: progress.update(bar, completed=done, total=total))
    except KeyboardInterrupt:
        raise AutoexposeError(
            f"camera {serial}: stopped before the measurement was complete: nothing was written"
        ) from None
