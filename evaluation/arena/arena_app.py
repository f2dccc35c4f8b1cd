"""The command `autoexpose arena`."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, OWN, POLICY_IDS, check_policy_id
from autoexpose_daemon.own_policy.installed import register_policies
from evaluation.arena.ablation import (
    Ablation,
    ablation_courses,
    ablation_document,
    policy_constants,
    print_ablation,
    write_ablation,
)
from evaluation.arena.ablation import ablate as ablate_policy
from evaluation.arena.arena_report import cells, mean_ratios, write_arena_report
from evaluation.arena.count import count_policy, print_count
from evaluation.arena.runs import ArenaRun, Task, document, full_plan, jobs_of, quick_plan, runs_of
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import CLUSTER, CORES, FINISHED, KEPT, PROCESSES, Workers, run_long, workers_of
from evaluation.long_runs import check_chosen, make_writable
from evaluation.scenes.scenarios import SCENARIOS
from fake_camera.world.scene.panorama import load_radiance
from imaging.errors import ConfigurationError

_ALL_POLICIES = ",".join(POLICY_IDS)
arena_app = typer.Typer(add_completion=False)


@arena_app.callback(invoke_without_command=True)
def arena(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Every scenario once: about a minute.")] = False,
    full: Annotated[bool, typer.Option("--full", help="Every scenario in many scenes: up to an hour.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all numbers to this JSON file.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a report with plots into this folder.")] = None,
    policies: Annotated[str, typer.Option(help="Ids, separated by commas.")] = _ALL_POLICIES,
    scenarios: Annotated[str, typer.Option(help="Ids, separated by commas.")] = ",".join(SCENARIOS),
    pictures: Annotated[Path | None, typer.Option(help="A folder of Radiance .hdr files: further scenes.")] = None,
    jobs: PROCESSES = CORES,
    cluster: CLUSTER = None,
    kept: KEPT = FINISHED,
    count: Annotated[bool, typer.Option("--count", help="Only count what --policy's decision is made of.")] = False,
    ablate: Annotated[
        bool, typer.Option("--ablate", help="Alter each constant of --policy: over an hour, half with --quick.")
    ] = False,
    policy: Annotated[str, typer.Option(help="Of --count and --ablate.")] = DEFAULT_POLICY,
) -> None:
    """Run every policy through every scenario and compare them with the best exposure of each frame."""
    register_policies()
    chosen = _chosen(policies, scenarios)
    if json_file is not None and not json_file.parent.is_dir():
        raise ConfigurationError(f"{json_file}: there is no folder {json_file.parent}: create it or name another file")
    if count or ablate:
        if full or pictures or policies != _ALL_POLICIES or (count and (ablate or quick or report)):
            raise ConfigurationError(
                "--count takes --policy and --json, --ablate also --quick, --scenarios, --jobs, --cluster, --kept and "
                "--report: leave the others out"
            )
        check_policy_id(policy)
        if policy in OWN:
            raise ConfigurationError(f"--count and --ablate read the sources of autoexpose, not those of {policy}")
        _check_places(json_file, report)
        if count:
            _count(policy, json_file)
            return
        courses = ablation_courses(chosen[1], quick)
        make_writable(kept, "--kept")
        ablation = ablate_policy(
            policy, policy_constants(policy)[0], courses,
            kept=ResultCache(kept), workers=workers_of(jobs, cluster), console=Console(),
        )  # fmt: skip
        _show_ablation(ablation, json_file, report)
        return
    stills = _pictures(pictures) if pictures else []

    def plan_of(quick: bool) -> list[Task]:
        return (quick_plan if quick else full_plan)(chosen[1], stills)

    check_chosen(quick, full, lambda quick: _duration_s(plan_of(quick), chosen[0], jobs))
    _check_places(json_file, report)
    make_writable(kept, "--kept")
    console = Console()
    runs = _run(plan_of(quick), chosen[0], ResultCache(kept), workers_of(jobs, cluster), console)
    figures = document(runs, DEFAULT_POLICY)
    _write(figures, json_file)
    _print(figures["results"], console)
    if report is not None:
        console.print(f"report: {write_arena_report(runs, DEFAULT_POLICY, report)}")


def _write(figures: dict[str, Any], json_file: Path | None) -> None:
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _count(policy: str, json_file: Path | None) -> None:
    counts = count_policy(policy)
    _write(counts, json_file)
    print_count(counts, Console())


def _show_ablation(ablation: Ablation, json_file: Path | None, report: Path | None) -> None:
    console = Console()
    _write(ablation_document(ablation), json_file)
    print_ablation(ablation, console)
    if report is not None:
        console.print(f"report: {write_ablation(ablation, report)}")


def _chosen(policies: str, scenarios: str) -> tuple[list[str], list[str]]:
    """The requested ids, each once."""
    policy_ids = list(dict.fromkeys(policies.split(",")))
    scenario_ids = list(dict.fromkeys(scenarios.split(",")))
    for policy in policy_ids:
        check_policy_id(policy)
    for scenario in scenario_ids:
        if scenario not in SCENARIOS:
            raise ConfigurationError(f"there is no scenario {scenario!r}: choose from {', '.join(SCENARIOS)}")
    return policy_ids, scenario_ids


def _pictures(folder: Path) -> list[str]:
    stills = sorted(folder.glob("*.hdr"))
    if not stills:
        raise ConfigurationError(f"{folder}: no .hdr file in it: give a folder of Radiance pictures")
    try:
        for still in stills:  # one that cannot be read would end the arena when its turn comes
            load_radiance(still)
    except ValueError as error:
        raise ConfigurationError(f"--pictures: {error}") from None
    return [str(still) for still in stills]


def _check_places(json_file: Path | None, report: Path | None) -> None:
    """Nothing is kept of an arena whose results cannot be written."""
    if json_file is not None:
        if json_file.is_dir():
            raise ConfigurationError(f"{json_file}: is a folder: name a file in --json")
        make_writable(json_file.parent, "--json")
    if report is not None:
        make_writable(report, "--report")


def _duration_s(plan: Sequence[Task], policies: Sequence[str], processes: int) -> float:
    return sum(job.cost_s for task in plan for job in jobs_of(task, policies)) / processes


def _run(
    plan: Sequence[Task], policies: Sequence[str], kept: ResultCache, workers: Workers, console: Console
) -> list[ArenaRun]:
    asked = [(task, policy) for task in plan for policy in policies]
    jobs = [job for task in plan for job in jobs_of(task, policies)]
    found = run_long(jobs, kept, workers, console, "arena")
    return [run for (task, policy), result in zip(asked, found, strict=True) for run in runs_of(task, policy, result)]


def _print(rows: Sequence[dict[str, object]], console: Console) -> None:
    scenarios = [scenario for scenario in SCENARIOS if any(row["scenario"] == scenario for row in rows)]
    ranking = mean_ratios(rows)
    policies = [policy for policy, _ in ranking]
    ratios = cells(rows, policies, scenarios, "objective_ratio_mean")
    settle = cells(rows, policies, scenarios, "settle_frames")
    title = "Mean of what each policy maximises as a share of the oracle's; below it, the median of frames to settle"
    table = Table(title=title, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("policy", no_wrap=True)
    for scenario in scenarios:
        table.add_column(scenario.replace("_", "\n"), justify="right")
    table.add_column("mean", justify="right")
    for (policy, mean), shares, frames in zip(ranking, ratios, settle, strict=True):
        figures = [
            f"{share:.2f}\n[dim]{'-' if math.isnan(count) else f'{count:.0f}'}[/]"
            for share, count in zip(shares, frames, strict=True)
        ]
        table.add_row(policy, *figures, f"{mean:.3f}")
    console.print(table)
