"""What holds for the section of every experiment."""

from __future__ import annotations

from evaluation.experiments.experiment import Figure, ReportSection, Table


def check_no_prose(section: ReportSection) -> None:
    """Below the method there are numbers only: what explains those of one run stands in docs, with its date."""
    assert all(isinstance(part, Table | Figure) for part in section.parts)
