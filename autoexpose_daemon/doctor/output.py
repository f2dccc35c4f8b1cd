"""The findings as text, and as JSON."""

from __future__ import annotations

import json
import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict

from rich.console import Console
from rich.text import Text

from autoexpose_daemon.doctor.finding import Finding, Severity

_COLOURS: dict[Severity, str] = {"stops": "bold red", "warning": "yellow", "ok": "green"}
_INDENT = 9


def as_json(findings: Sequence[Finding]) -> str:
    """All findings as a JSON document."""
    return json.dumps({"stops": stops(findings), "findings": [asdict(finding) for finding in findings]}, indent=1)


def stops(findings: Sequence[Finding]) -> bool:
    """Whether the daemon would not run."""
    return any(finding.severity == "stops" for finding in findings)


def show(findings: Sequence[Finding], console: Console) -> None:
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
