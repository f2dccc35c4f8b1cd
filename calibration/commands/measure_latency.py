"""The command `autoexpose calibrate latency`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from calibration.commands.additions import response_file_of
from calibration.latency.trials import TRIALS, capture_latency
from calibration.latency.write_effect import WriteEffect
from calibration.sources.session import Session, session_setup
from drivers.aravis import open_camera
from imaging.errors import AutoexposeError


def latency(
    *,
    camera: Annotated[str, typer.Option(help="Serial number.")],
    rate_hz: Annotated[float, typer.Option(min=0.1, help="Frame rate to measure at, ideally the rig's.")] = 60.0,
    writes: Annotated[int, typer.Option(min=5, help="Writes of exposure time, and as many of gain.")] = TRIALS,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Response file to add the result to.")] = None,
) -> None:
    """Measure how many frames it takes for a write of exposure time or of gain to show, and how regular that is."""
    console = Console(highlight=False)
    file = None if output is None else response_file_of(output, camera)
    with Session(open_camera(camera, session_setup(rate_hz=rate_hz))) as session:
        effects = _measure(session, camera, rate_hz, writes, console)
    if any(effect.frames or effect.unclear for effect in effects):
        console.print(latency_table(f"camera {camera} at {rate_hz:g} Hz", effects))
    for effect in effects:
        if effect.frames:
            console.print(when_it_shows(effect), soft_wrap=True)
    if len(effects) == 1:
        console.print("gain is left out: this camera has no adjustable gain in dB")
    for finding in dict.fromkeys(finding for effect in effects for finding in effect.findings):
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True)
    refused = [effect for effect in effects if any(finding.severity == "refused" for finding in effect.findings)]
    if file is not None and output is not None and not refused:
        replace(file, latency=latency_document(rate_hz, effects)).save(output)
        console.print(f"written: {output}", soft_wrap=True)
    if refused:
        raise typer.Exit(1)


def latency_table(title: str, effects: Sequence[WriteEffect]) -> Table:
    """One row for each number of frames that was seen."""
    table = Table("write of", "frames until it shows", "writes", "share", "", title=title, title_justify="left")
    for effect in effects:
        clear = sum(effect.frames.values())
        for frames, count in effect.frames.items():
            share = count / clear
            table.add_row(effect.quantity, str(frames), str(count), f"{share:.0%}", "#" * round(20 * share))
        if effect.unclear:
            table.add_row(effect.quantity, "unclear", str(effect.unclear), "", "")
        table.add_section()
    return table


def when_it_shows(effect: WriteEffect) -> str:
    """The same as times: when writes were made, and how much later the exposures that show them start."""
    assert effect.lead_us is not None
    assert effect.delay_us is not None
    early_ms, late_ms = (delay_us * 1e-3 for delay_us in effect.delay_us)
    written = f"{effect.quantity}: written {effect.lead_us * 1e-3:.1f} ms after the start of an exposure"
    if early_ms < 0:
        return f"{written}; exposures that start {late_ms:.1f} ms after the write, and earlier ones perhaps, show it"
    if early_ms < late_ms:
        return f"{written}; exposures that start {early_ms:.1f} ms after the write do not show it, {late_ms:.1f} ms do"
    return f"{written}; how long after the write an exposure starts does not decide whether it shows it"


def latency_document(rate_hz: float, effects: Sequence[WriteEffect]) -> dict[str, Any]:
    """The content of `latency` in a response file."""
    document: dict[str, Any] = {"rate_hz": rate_hz}
    for effect in effects:
        entry: dict[str, Any] = {"mode_frames": effect.mode, "frames": effect.frames, "untold": effect.unclear}
        if effect.findings:
            entry["findings"] = [asdict(finding) for finding in effect.findings]
        document[effect.quantity] = entry
    return document


def _measure(session: Session, serial: str, rate_hz: float, writes: int, console: Console) -> list[WriteEffect]:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("left"), TimeRemainingColumn())
    try:
        with Progress(*columns, console=console) as progress:
            bar = progress.add_task(f"camera {serial}", total=None)
            return capture_latency(
                session, rate_hz, writes, lambda done, total: progress.update(bar, completed=done, total=total)
            )
    except KeyboardInterrupt:
        raise AutoexposeError(
            f"camera {serial}: stopped before the measurement was complete: nothing was written"
        ) from None
