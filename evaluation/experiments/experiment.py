"""What an experiment is: jobs that measure, and a section of the report that judges the papers' claims."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from evaluation.jobs.job import Job, Plain
from imaging.python310 import StrEnum


class Verdict(StrEnum):
    """The judgement on a claim."""

    REPRODUCED = "reproduced"
    CONDITIONALLY = "reproduced under conditions"
    NOT_REPRODUCED = "not reproduced"
    UNDECIDED = "undecided"

    @classmethod
    def of(cls, holds: bool) -> Verdict:
        """On a claim that holds or does not."""
        return cls.REPRODUCED if holds else cls.NOT_REPRODUCED


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of a paper, and what we saw."""

    source: str  # where the paper says it: "B&H Fig. 10".
    claim: str  # what it says, with its numbers, in our words
    ours: str  # our numbers, with their spread or interval
    verdict: Verdict  # by a rule that the code fixes before it sees the numbers
    condition: str = ""  # under which conditions it holds, or by which number it does not
    counted: bool = True  # whether it counts in the tally: a claim of the papers, and only once

    @classmethod
    def of_this_project(cls, claim: str, ours: str, *, holds: bool) -> Claim:
        """One of ours, which counts in no tally."""
        return cls("this project", claim, ours, Verdict.of(holds), counted=False)


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts; the first column is left-aligned, all others are numbers."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class Figure:
    """A PNG in the report's folder."""

    file: str
    caption: str


@dataclass(frozen=True, slots=True)
class ReportSection:
    """An experiment's part of the report."""

    setting: str  # how it was measured, and how that differs from the paper: short paragraphs
    claims: Sequence[Claim]  # the paper's claims, each with its verdict
    # Tables and figures, in their order. No prose: a conclusion must follow from the numbers by a rule, as verdicts do,
    # or it stands in docs/understand/evidence.md.
    parts: Sequence[Table | Figure]


# Arguments and result of each job, in the order of the jobs.
Results: TypeAlias = "Sequence[tuple[Mapping[str, Plain], Any]]"


def jobs_and_results(results: Results) -> Plain:
    """Arguments and result of each job: the data of an experiment that has no form of its own."""
    return {"results": [{"arguments": dict(arguments), "result": result} for arguments, result in results]}


@dataclass(frozen=True, slots=True)
class Experiment:
    """One of the papers' experiments."""

    name: str  # as in `autoexpose experiments run fig1`
    title: str  # one line
    jobs: Callable[[bool], list[Job]]  # the jobs of a quick run (True: minutes in total, for CI) or of the full run
    # Judges the results; draws its figures into the folder that it is given.
    section: Callable[[Results, Path], ReportSection]
    data: Callable[[Results], Plain] = jobs_and_results  # what `--json` writes of the results
    in_all: bool = True  # whether `autoexpose experiments run all` includes it
