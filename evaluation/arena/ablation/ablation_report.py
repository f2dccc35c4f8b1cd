"""The table of an ablation: Markdown, on the console, and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.arena.ablation.ablation import ALL, Ablation, Figures, policy_constants
from evaluation.arena.count import ROOT, c_files, count_c, count_python, python_files

COLUMNS: dict[str, tuple[str, str]] = {
    "mean": ("objective_ratio_mean", "{:.3f}"),
    "worst 5 %": ("objective_ratio_p05", "{:.3f}"),
    "settle": ("settle_frames", "{:.0f}"),
    "stuck": ("stuck_share", "{:.2f}"),
    "lost pairs": ("lost_pair_share", "{:.3f}"),
}
"""By title: a name in the rows of `results`, and how it is shown."""

HOW_TO_READ = """\
Each row is one constant doubled, halved, or at the value at which its file's `NEUTRAL` says that it has no effect, in
a process of its own whose source was altered before anything imported it; the first row is the unaltered policy. Mean
and worst 5 % of frames are of its own objective, as a share of the best exposure of each frame; unaltered code judges,
and splits that best as the unaltered policy does. So rows can be compared, and can exceed 1. Settle: median of frames,
`-` if most courses are stuck. By scenario: mean / worst 5 %. `=`: no decision changed. There is one tuning course for
each scenario, so small differences may be chance.
"""


def write_ablation(ablation: Ablation, folder: Path) -> Path:
    """Write `ablation.md` into a folder; returns its path."""
    head, *rows = _cells(ablation)
    lines = [head, ["---"] * len(head), *rows]
    table = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
    path = folder / "ablation.md"
    title = f"# Every constant of `{ablation.policy}`"
    parts = [title, HOW_TO_READ.strip(), _courses(ablation), table, not_altered(ablation)]
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path


def print_ablation(ablation: Ablation, console: Console) -> None:
    """The table without reasons and scenarios, and what is not in it."""
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    head, *rows = [[line[0], *line[2 : 4 + len(COLUMNS)]] for line in _cells(ablation)]
    for title in head:
        table.add_column(title, justify="right" if table.columns else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)
    console.print(f"{_courses(ablation)} {not_altered(ablation)}", highlight=False)


def ablation_document(ablation: Ablation) -> dict[str, Any]:
    """All of it as plain data."""
    return {**asdict(ablation), "not_altered": not_altered(ablation)}


def not_altered(ablation: Ablation) -> str:
    """What the table lacks."""
    python = list(python_files(ablation.policy).values())
    numbers = sum(count_python(path.read_text(encoding="utf-8")).numbers for path in python)
    in_c = {path: count_c(path.read_text(encoding="utf-8")).numbers for path in c_files(python)}
    named = ", ".join(str(path.relative_to(ROOT)) for path, count in in_c.items() if count)
    constants = len({(trial.constant.module, trial.constant.name) for trial in ablation.trials})
    copied = ", ".join(constant.name for constant in policy_constants(ablation.policy)[1]) or "none"
    return (
        f"Altered: {constants} constants. Not altered: numbers in tables and within functions (Python has {numbers} "
        f"numbers in all), and all {sum(in_c.values())} in C, which is built already ({named}), so none of which C "
        f"has a copy: {copied}."
    )


def _courses(ablation: Ablation) -> str:
    return "Courses: " + ", ".join(f"{scenario} {scene} {seed}" for scenario, scene, seed in ablation.courses) + "."


def _cells(ablation: Ablation) -> list[list[str]]:
    """The table, line by line, heads first."""
    scenarios = [scenario for scenario in ablation.unaltered if scenario != ALL]

    def figures(of: Figures) -> list[str]:
        whole = [_shown(of[ALL][key], form) for key, form in COLUMNS.values()]
        shares = list(COLUMNS.values())[:2]
        return [*whole, *(" / ".join(_shown(of[each][key], form) for key, form in shares) for each in scenarios)]

    lines = [
        ["constant", "what it is", "value", "altered", *COLUMNS, *scenarios],
        ["unaltered", "", "", "", *figures(ablation.unaltered)],
    ]
    for trial in ablation.trials:
        constant = trial.constant
        name = f"{constant.module.removeprefix('autoexpose_daemon.control.')}.{constant.name}"
        altered = f"{trial.what}: {constant.alterations[trial.what].text}" if trial.what == "off" else trial.what
        same = ["="] * (len(COLUMNS) + len(scenarios))
        failed = [f"fails: {trial.error}", *[""] * (len(same) - 1)]
        shown = failed if trial.error else same if trial.idle else figures(trial.figures)
        lines.append([f"`{name}`", constant.reason, f"{constant.value:g}", altered, *shown])
    return lines


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
