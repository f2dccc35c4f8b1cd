"""The report of a run as Markdown and as one HTML page: the verdicts first, then each experiment."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import jinja2

from evaluation.experiments.experiment import Claim, Experiment, Figure, Section, Table, Verdict

Chapter = tuple[Experiment, Section]


def write_experiments_report(chapters: Sequence[Chapter], preface: str, folder: Path) -> Path:
    """Write `experiments.md` and `experiments.html` into the folder that holds the figures; returns the first."""
    markdown = folder / "experiments.md"
    markdown.write_text("\n\n".join(_markdown(chapters, preface)) + "\n", encoding="utf-8")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("evaluation.experiments", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"prose": _prose, "inline": _inline}
    environment.tests["table"] = lambda part: isinstance(part, Table)
    page = environment.get_template("experiments_report.html").render(
        chapters=chapters, preface=preface, count=count_of_verdicts(chapters)
    )
    (folder / "experiments.html").write_text(page, encoding="utf-8")
    return markdown


def count_of_verdicts(chapters: Sequence[Chapter]) -> str:
    """The number of the papers' claims with each verdict, in a line."""
    claims = [claim for _, section in chapters for claim in section.claims]
    counts = Counter(claim.verdict for claim in claims if claim.counted)
    rest = len(claims) - counts.total()
    return (
        f"{counts.total()} claim{'s' if counts.total() != 1 else ''}: "
        + ", ".join(f"{counts[verdict]} {verdict}" for verdict in Verdict if counts[verdict] or verdict != "undecided")
        + "."
        + (f" Not counted: {rest} on our own policies or on a second reading of a law." if rest else "")
    )


def _markdown(chapters: Sequence[Chapter], preface: str) -> list[str]:
    parts = ["# The papers' experiments on the simulated rig", preface, "## Verdicts", count_of_verdicts(chapters)]
    parts.append(_claims([(experiment.name, claim) for experiment, section in chapters for claim in section.claims]))
    for experiment, section in chapters:
        parts += [f"## {experiment.name}: {experiment.title}", section.setting.strip()]
        for part in section.parts:
            match part:
                case Table():
                    parts += [part.caption, _table(part)]
                case Figure():
                    parts.append(f"![{part.caption}]({part.file})\n\n*{part.caption}*")
    return parts


def _claims(claims: Sequence[tuple[str, Claim]]) -> str:
    lines = ["| experiment | the paper | says | we saw | verdict |", "|---|---|---|---|---|"]
    for name, claim in claims:
        verdict = f"**{claim.verdict}**" + (f": {claim.condition}" if claim.condition else "")
        lines.append(_row([f"`{name}`", claim.source, claim.claim, claim.ours, verdict]))
    return "\n".join(lines)


def _table(table: Table) -> str:
    return "\n".join([_row(table.heads), "|---|" + "---:|" * (len(table.heads) - 1), *map(_row, table.rows)])


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _inline(text: str) -> str:
    """A line of plain text with `code` spans, as HTML."""
    pieces = html.escape(text.strip()).split("`")
    return "".join(f"<code>{piece}</code>" if place % 2 else piece for place, piece in enumerate(pieces))


def _prose(text: str) -> str:
    """Paragraphs of such text, as HTML."""
    return "".join(f"<p>{paragraph}</p>" for paragraph in _inline(text).split("\n\n"))
