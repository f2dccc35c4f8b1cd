"""The doctor's examination of a host: from facts to findings, as text and as JSON."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.doctor.access import judge_access
from autoexpose_daemon.doctor.facts import Diagnosis, Facts, Need, Severity, gather
from autoexpose_daemon.doctor.judge import judge_gige, judge_usb
from documents.command_line import CommandOutput
from imaging.errors import ConfigurationError


def judge(facts: Facts, need: Need) -> list[Diagnosis]:
    """What the facts mean for a daemon with these needs."""
    return [
        *_missing(facts, need),
        *_without_ptp(facts, need),
        *judge_usb(facts.usb, need, facts.serials),
        *judge_gige(facts.gige, need),
    ]


def judge_policy(config: Config) -> Iterator[Diagnosis]:
    """Build the policy of each group of cameras as the daemon would."""
    from imaging.response import ResponseFunction  # noqa: PLC0415  loads OpenCV

    said: set[str] = set()
    for group in map(config.of_group, config.cameras_of_groups):
        limits, start, policy = group.exposure.limits(), group.start, group.control.policy
        try:
            from autoexpose_daemon.control.loop import ControlLoop  # noqa: PLC0415  needs the C extension

            ControlLoop(policy, ResponseFunction.linear(), limits, start, group.control.parameters())
        except ConfigurationError as error:
            if str(error) not in said:
                said.add(str(error))
                yield Diagnosis("policy", "stops", str(error))


def judge_features(config: Config) -> Iterator[Diagnosis]:
    """Open each camera as the daemon would, and close it again."""
    from autoexpose_daemon.runtime.setup import refusals  # noqa: PLC0415  loads Aravis, and needs the C extension

    for name, error in refusals(config):
        camera = config.cameras[name]
        if error is None:
            sentence = f"{name} camera {camera.serial} takes all {len(camera.features)} features"
            yield Diagnosis("features", "ok", sentence)
        else:
            yield Diagnosis("features", "stops", f"{name} camera: {error}", f"autoexpose features {camera.serial}")


def _without_ptp(facts: Facts, need: Need) -> Iterator[Diagnosis]:
    for camera in facts.usb.cameras if need.ptp else ():
        if need.wants(camera.serial):
            sentence = f"{need.name(camera.serial)} is on USB3 Vision, where there is no PTP"
            yield Diagnosis("ptp", "stops", sentence, "trigger.mode: software   # in the configuration, or a wire")


def _missing(facts: Facts, need: Need) -> Iterator[Diagnosis]:
    there = ", ".join(facts.serials) or "none"
    for camera, serial in need.serials.items():
        if serial not in facts.serials:
            sentence = f"{need.name(serial)} not found; cameras found: {there}"
            fix = f"autoexpose list   # after checking power and cable: is one of them cameras.{camera}.serial?"
            yield Diagnosis("camera-missing", "stops", sentence, fix)
    if not need.serials and not (facts.usb.cameras or facts.gige.cameras):
        sentence = "no camera found, neither USB3 Vision nor GigE Vision"
        fix = "autoexpose list   # after checking power and cables: says which cameras answer"
        yield Diagnosis("camera-missing", "stops", sentence, fix)


_COLOURS: dict[Severity, str] = {"stops": "bold red", "warning": "yellow", "ok": "green"}
_INDENT = 9


def as_document(findings: Sequence[Diagnosis]) -> dict[str, Any]:
    """All findings as a document."""
    return {"stops": stops(findings), "findings": [asdict(finding) for finding in findings]}


def stops(findings: Sequence[Diagnosis]) -> bool:
    """Whether the daemon would not run."""
    return any(finding.severity == "stops" for finding in findings)


def show(findings: Sequence[Diagnosis], console: Console) -> None:
    """Print each finding, with its fix unbroken on a line of its own, and a summary."""
    for finding in findings:
        lines = textwrap.wrap(finding.sentence, console.width - _INDENT, break_on_hyphens=False)
        sentence = ("\n" + " " * _INDENT).join(lines)
        severity = (f"{finding.severity:<{_INDENT}}", _COLOURS[finding.severity])
        console.print(Text.assemble(severity, sentence), soft_wrap=True)
        if finding.fix is not None:
            console.print(Text(f"{'':{_INDENT}}$ {finding.fix}", "cyan"), soft_wrap=True)
    count = Counter(finding.severity for finding in findings)
    verdict = "The daemon would not run" if stops(findings) else "Nothing stops the daemon"
    sums = ", ".join(f"{count[severity]} {severity}" for severity in _COLOURS)
    console.print(Text(f"{verdict} ({sums})."), soft_wrap=True)


def examine(config: Path | None, output: CommandOutput, report: Path | None = None) -> bool:
    """Examine the host for a configuration and print the findings; True if the daemon could run.

    With `report`, write a report on the cameras to that file instead.
    """
    loaded = None if config is None else load_config(config)
    need = Need.of(loaded)
    facts = gather(wanted=need.serials.values())
    if report is not None:
        from autoexpose_daemon.doctor.camera_report import write_report  # noqa: PLC0415  loads Aravis

        write_report(report, facts, need, output.say)
        return True
    findings = [*judge(facts, need), *judge_access(None if loaded is None else loaded.publish)]
    if loaded is not None:
        findings += judge_policy(loaded)
        findings += [Diagnosis("calibration", "warning", note) for note in loaded.notes]
        if not stops(findings) and any(camera.features for camera in loaded.cameras.values()):
            findings += judge_features(loaded)
    output.document |= as_document(findings)
    if not output.as_json:
        show(findings, output)
    return not stops(findings)
