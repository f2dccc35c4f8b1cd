"""What holds for the section of every experiment."""

from __future__ import annotations

from pathlib import Path

from evaluation.experiments.experiment import Figure, ReportSection, Table


def check_section(section: ReportSection, folder: Path) -> None:
    """Below the method there are numbers only: what explains those of one run stands in docs, with its date.

    All figures are there.
    """
    assert all(isinstance(part, Table | Figure) for part in section.parts)
    for part in section.parts:
        if isinstance(part, Figure):
            assert (folder / part.file).stat().st_size > 0
