"""The report of a run: the verdicts first, then each experiment; as Markdown and as one HTML page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import jinja2

from evaluation.experiments.experiment import Claim, Experiment, Figure, Section, Table

Chapter = tuple[Experiment, Section]


def write_report(chapters: Sequence[Chapter], preface: str, folder: Path) -> Path:
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
    environment.filters["prose"] = _prose
    environment.tests["table"] = lambda part: isinstance(part, Table)
    environment.tests["figure"] = lambda part: isinstance(part, Figure)
    page = environment.get_template("report.html").render(chapters=chapters, preface=preface)
    (folder / "experiments.html").write_text(page, encoding="utf-8")
    return markdown


def _markdown(chapters: Sequence[Chapter], preface: str) -> list[str]:
    parts = ["# The papers' experiments on the simulated rig", preface, "## Verdicts"]
    parts.append(_claims([(experiment.name, claim) for experiment, section in chapters for claim in section.claims]))
    for experiment, section in chapters:
        parts += [f"## {experiment.name}: {experiment.title}", section.setting.strip()]
        for part in section.parts:
            match part:
                case Table():
                    parts += [part.caption, _table(part)]
                case Figure():
                    parts.append(f"![{part.caption}]({part.file})\n\n*{part.caption}*")
                case str():
                    parts.append(part.strip())
    return parts


def _claims(claims: Sequence[tuple[str, Claim]]) -> str:
    lines = ["| experiment | the paper | says | we saw | verdict |", "|---|---|---|---|---|"]
    for name, claim in claims:
        verdict = f"**{claim.verdict}**" + (f": {claim.condition}" if claim.condition else "")
        lines.append(f"| `{name}` | {claim.source} | {claim.claim} | {claim.ours} | {verdict} |")
    return "\n".join(lines)


def _table(table: Table) -> str:
    lines = ["| " + " | ".join(table.heads) + " |", "|---|" + "---:|" * (len(table.heads) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in table.rows)])


def _prose(text: str) -> str:
    """Paragraphs of plain text, with `code` as Markdown has it."""
    pieces = html.escape(text.strip()).split("`")
    marked = "".join(f"<code>{piece}</code>" if place % 2 else piece for place, piece in enumerate(pieces))
    return "".join(f"<p>{paragraph}</p>" for paragraph in marked.split("\n\n"))
