"""The doctor's examination of a host."""

from __future__ import annotations

from pathlib import Path

import typer
from rich.console import Console

from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.doctor.facts import gather
from autoexpose_daemon.doctor.finding import Finding
from autoexpose_daemon.doctor.judge import judge
from autoexpose_daemon.doctor.need import Need
from autoexpose_daemon.doctor.output import as_json, show, stops


def examine(config: Path | None, as_document: bool, report: Path | None = None) -> bool:
    """Examine the host for a configuration and print the findings; True if the daemon could run.

    With `report`, write a report on the cameras to that file instead.
    """
    loaded = None if config is None else load_config(config)
    need = Need.of(loaded)
    facts = gather(wanted=need.serials.values())
    if report is not None:
        from autoexpose_daemon.doctor.camera_report import write_report  # noqa: PLC0415  loads Aravis

        write_report(report, facts, need, typer.echo)
        return True
    findings = judge(facts, need)
    if loaded is not None:
        from autoexpose_daemon.doctor.judge_policy import judge_policy  # noqa: PLC0415  loads OpenCV

        findings += judge_policy(loaded)
        findings += [Finding("calibration", "warning", note) for note in loaded.notes]
    if loaded is not None and not stops(findings) and any(camera.features for camera in loaded.sides.values()):
        from autoexpose_daemon.doctor.judge_features import judge_features  # noqa: PLC0415  loads Aravis

        findings += judge_features(loaded)
    if as_document:
        typer.echo(as_json(findings))
    else:
        show(findings, Console())
    return not stops(findings)
