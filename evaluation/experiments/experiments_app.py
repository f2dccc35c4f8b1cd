"""The command `autoexpose experiments`, and the report of its runs as Markdown and HTML."""

from __future__ import annotations

import html
import json
import math
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import jinja2
import typer
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Table, Verdict
from evaluation.experiments.registry import EXPERIMENTS
from evaluation.jobs.job import Plain
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import CLUSTER, CORES, FINISHED, KEPT, PROCESSES, run_long, workers_of
from evaluation.long_runs import check_chosen, make_writable
from evaluation.prose import markdown_table
from imaging.errors import AutoexposeError, ConfigurationError

Chapter = tuple[Experiment, ReportSection]


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
        title=_title(chapters), chapters=chapters, preface=preface, count=count_of_verdicts(chapters)
    )
    (folder / "experiments.html").write_text(page, encoding="utf-8")
    return markdown


def _title(chapters: Sequence[Chapter]) -> str:
    return chapters[0][0].title if len(chapters) == 1 else "Experiments on the simulated rig"


def count_of_verdicts(chapters: Sequence[Chapter]) -> str:
    """The number of the papers' claims with each verdict, in a line; empty without claims."""
    claims = [claim for _, section in chapters for claim in section.claims]
    counts = Counter(claim.verdict for claim in claims if claim.counted)
    rest = len(claims) - counts.total()
    if not counts:
        return f"{rest} claim{'s' if rest > 1 else ''} of our own." if rest else ""
    return (
        f"{counts.total()} claim{'s' if counts.total() != 1 else ''}: "
        + ", ".join(f"{counts[verdict]} {verdict}" for verdict in Verdict if counts[verdict] or verdict != "undecided")
        + "."
        + (f" Not counted: {rest} on our own policies or on a second reading of a law." if rest else "")
    )


def _markdown(chapters: Sequence[Chapter], preface: str) -> list[str]:
    parts = [f"# {_title(chapters)}", preface]
    claims = [(experiment.name, claim) for experiment, section in chapters for claim in section.claims]
    if claims:
        parts += ["## Verdicts", count_of_verdicts(chapters), _claims(claims)]
    for experiment, section in chapters:
        parts += [f"## {experiment.name}: {experiment.title}", section.setting.strip()]
        for part in section.parts:
            match part:
                case Table():
                    parts += [part.caption, markdown_table(part.heads, part.rows)]
                case Figure():
                    parts.append(f"![{part.caption}]({part.file})\n\n*{part.caption}*")
    return parts


def _claims(claims: Sequence[tuple[str, Claim]]) -> str:
    heads, rows = ["experiment", "the paper", "says", "we saw", "verdict"], []
    for name, claim in claims:
        verdict = f"**{claim.verdict}**" + (f": {claim.condition}" if claim.condition else "")
        rows.append([f"`{name}`", claim.source, claim.claim, claim.ours, verdict])
    return markdown_table(heads, rows, texts=len(heads))


def _inline(text: str) -> str:
    """A line of plain text with `code` spans, as HTML."""
    pieces = html.escape(text.strip()).split("`")
    return "".join(f"<code>{piece}</code>" if place % 2 else piece for place, piece in enumerate(pieces))


def _prose(text: str) -> str:
    """Paragraphs of such text, as HTML."""
    return "".join(f"<p>{paragraph}</p>" for paragraph in _inline(text).split("\n\n"))


experiments_app = typer.Typer(add_completion=False, no_args_is_help=True)
_Folder = Annotated[Path, typer.Option(help="Folder for the report and its figures.")]
_COLOURS = {"reproduced": "green", "reproduced under conditions": "yellow", "not reproduced": "red", "undecided": "dim"}


@experiments_app.callback()
def experiments() -> None:
    """The papers' experiments on the simulated rig: figures, numbers, and a verdict on each claim."""


@experiments_app.command("list")
def list_all() -> None:
    """List the experiments."""
    for experiment in EXPERIMENTS:
        typer.echo(f"{experiment.name:12} {experiment.title}")


@experiments_app.command()
def run(
    names: Annotated[list[str], typer.Argument(help="`all`, or names shown by `autoexpose experiments list`.")],
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Few scenes and seeds: minutes.")] = False,
    full: Annotated[bool, typer.Option("--full", help="What the verdicts rest on: up to hours.")] = False,
    out: _Folder = Path("out/experiments"),
    jobs: PROCESSES = CORES,
    cluster: CLUSTER = None,
    kept: KEPT = FINISHED,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Also write the numbers to this file, by experiment if several.")
    ] = None,
) -> None:
    """Run experiments and write `experiments.md` and `experiments.html`; finished jobs are not repeated."""
    chosen = _chosen(names)
    check_chosen(quick, full, lambda quick: _duration_s(chosen, quick, jobs))
    make_writable(out, "--out")
    make_writable(kept, "--kept")
    if json_file is not None:
        make_writable(json_file.parent, "--json")
    console = Console()
    workers = workers_of(jobs, cluster)
    begun_s = time.monotonic()
    work = {experiment.name: experiment.jobs(quick) for experiment in chosen}
    everything = [job for jobs_of_one in work.values() for job in jobs_of_one]
    results = run_long(everything, ResultCache(kept), workers, console, "experiments")
    chapters: list[Chapter] = []
    data: dict[str, Plain] = {}
    for experiment in chosen:
        mine = work[experiment.name]
        measured, results = results[: len(mine)], results[len(mine) :]
        pairs = [(job.arguments, result) for job, result in zip(mine, measured, strict=True)]
        chapters.append((experiment, experiment.section(pairs, out)))
        data[experiment.name] = experiment.data(pairs)
    if json_file is not None:
        _write_json(data if len(data) > 1 else data[chosen[0].name], json_file)
    _show(chapters, console)
    report = write_experiments_report(chapters, _preface(names, quick), out)
    console.print(f"report: {report}, {report.with_suffix('.html').name} ({(time.monotonic() - begun_s) / 60:.1f} min)")


def _chosen(names: Sequence[str]) -> list[Experiment]:
    known = [experiment.name for experiment in EXPERIMENTS]
    for name in names:
        if name != "all" and name not in known:
            raise ConfigurationError(f"there is no experiment {name!r}: choose all, or from {', '.join(known)}")
    return [
        experiment for experiment in EXPERIMENTS if experiment.name in names or ("all" in names and experiment.in_all)
    ]


def _duration_s(chosen: Sequence[Experiment], quick: bool, processes: int) -> float:
    return sum(job.cost_s for experiment in chosen for job in experiment.jobs(quick)) / processes


def _write_json(data: Plain, file: Path) -> None:
    try:
        file.write_text(json.dumps(_without_nan(data), allow_nan=False, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise AutoexposeError(
            f"{file}: the numbers cannot be saved ({error.strerror}): finished jobs are kept, try another --json"
        ) from None


def _without_nan(data: Plain) -> Plain:
    """JSON has no NaN and no infinity: they become null."""
    match data:
        case float() if not math.isfinite(data):
            return None
        case dict():
            return {key: _without_nan(value) for key, value in data.items()}
        case list():
            return [_without_nan(value) for value in data]
    return data


def _preface(names: Sequence[str], quick: bool) -> str:
    command = " ".join(["autoexpose experiments run", *names, "--quick" if quick else "--full"])
    return f"""\
Made by `{command}`, in virtual time, from fixed seeds: the same code gives the same numbers, except ORB-SLAM3's.
Cameras, room and light are those of the fake cameras (docs/do/fake-camera.md); control is the daemon's own.
B&H is Bégin and Hunter, "Auto-Exposure Algorithm for Enhanced Mobile Robot Localization in Challenging Light
Conditions" (2022); MH is Majer et al., "Adaptive image processing methods for outdoor autonomous vehicles" (2018).
Intervals in brackets are 95 % bootstrap intervals, unless a section says otherwise."""


def _show(chapters: Sequence[Chapter], console: Console) -> None:
    """Print the verdicts, each with the claim and what we saw, wrapped to the terminal."""
    for experiment, section in chapters:
        console.print(f"\n[bold]{experiment.name}[/]  {experiment.title}")
        for claim in section.claims:
            console.print(f"  [{_COLOURS[claim.verdict]}]{claim.verdict}[/]")
            said = [f"{claim.source}: {claim.claim}", f"we saw: {claim.ours}", claim.condition]
            for line in filter(None, said):
                console.print(Padding(escape(line), (0, 0, 0, 4)))
    console.print(f"\n{count_of_verdicts(chapters)}")
