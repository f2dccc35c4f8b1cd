"""Runs jobs whose results are not kept yet, on the processes of this machine or of a cluster."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeAlias, TypeVar

import typer
from rich.console import Console

from evaluation.jobs.job import Job, Plain
from evaluation.jobs.kept import ResultCache
from evaluation.long_runs import LongProgress
from evaluation.pool import over_processes
from imaging.errors import AutoexposeError

Item = TypeVar("Item")
Result = TypeVar("Result")


class Workers(Protocol):
    """Does work on items, somewhere; yields each item with its result, in order of completion."""

    def __call__(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Generator[tuple[Item, Result]]:
        """Begin; it ends when the caller stops iterating."""
        ...


def here(processes: int) -> Workers:
    """The processes of this machine, as many as there is work for."""

    def work_here(work: Callable[[Item], Result], items: Sequence[Item]) -> Generator[tuple[Item, Result]]:
        return over_processes(work, items, max(min(processes, len(items)), 1))

    return work_here


# Called with each finished job and how long it took (s; 0 when its result was kept, or was asked for twice).
Advance = Callable[[Job, float], None]

# A job with all its places in the list of what was asked for; those of a batch run side by side.
_Placed = tuple[list[int], Job]


def run_jobs(jobs: Sequence[Job], kept: ResultCache, workers: Workers, advance: Advance) -> list[Plain]:
    """The results of all jobs, in their order; each is saved when it is ready, and equal jobs run once."""
    results: dict[int, Plain] = {}
    missing: dict[str, _Placed] = {}
    for place, job in enumerate(jobs):
        key = kept.key(job)
        known = kept.get(job)
        if known is not None:
            results[place] = known[0]
            advance(job, 0.0)
        else:
            missing.setdefault(key, ([], job))[0].append(place)
    with closing(workers(_measure, _batches(missing.values()))) as finished:
        for batch, (found, took_s) in finished:
            for (places, job), result in zip(batch, found, strict=True):
                kept.put(job, result)
                for place in places:
                    results[place] = plain(result)
                    advance(jobs[place], took_s / len(batch) if place == places[0] else 0.0)
    return [results[place] for place in range(len(jobs))]


def _batches(missing: Iterable[_Placed]) -> list[list[_Placed]]:
    """What runs as one, the longest first."""
    batches: dict[Any, list[_Placed]] = {}
    for number, (places, job) in enumerate(missing):
        alike = json.dumps(dict(job.arguments), sort_keys=True) if job.side_by_side else number
        batches.setdefault((job.measure, alike), []).append((places, job))
    return sorted(batches.values(), key=lambda batch: -sum(job.cost_s for _, job in batch))


def _measure(batch: list[_Placed]) -> tuple[list[Plain], float]:
    begun_s = time.perf_counter()
    job = batch[0][1]
    if job.side_by_side:
        policies = [policy for _, each in batch for policy in each.policies or ()]
        found: Any = job.measure(**job.arguments, policies=policies)
    else:
        found = [job.measure(**job.arguments)]
    return found, time.perf_counter() - begun_s


def run_long(jobs: Sequence[Job], kept: ResultCache, workers: Workers, console: Console, what: str) -> list[Plain]:
    """As `run_jobs`, with a bar. Raises AutoexposeError when it is stopped: what is finished is kept."""
    try:
        with LongProgress(console, 7200.0) as progress:
            bar = progress.add_task(what, total=sum(job.cost_s for job in jobs))

            def advance(job: Job, took_s: float) -> None:
                if took_s:
                    progress.update(bar, advance=job.cost_s)
                else:  # kept from earlier, so it says nothing about the speed
                    progress.update(bar, total=(progress.tasks[bar].total or 0.0) - job.cost_s)

            results = run_jobs(jobs, kept, workers, advance)
            if not progress.tasks[bar].total:
                progress.update(bar, total=1.0, completed=1.0, description=f"{what}, all kept from earlier")
            return results
    except BrokenProcessPool:
        raise AutoexposeError(
            f"{what}: a process was killed from outside, perhaps because memory ran out: try fewer --jobs; what is "
            "finished is kept, and the same command goes on where it was"
        ) from None
    except KeyboardInterrupt:
        raise AutoexposeError(f"{what}: stopped before the end: the same command goes on where it was") from None


def plain(value: Any) -> Plain:
    """A result as it will be read from disk, so that fresh and kept results are the same."""
    kept: Plain = json.loads(json.dumps(value))
    return kept


PROCESSES: TypeAlias = Annotated[int, typer.Option(min=1, help="Processes.")]
CORES = len(os.sched_getaffinity(0))
KEPT: TypeAlias = Annotated[Path, typer.Option(help="Folder for what is finished: a stopped run goes on from there.")]
FINISHED = Path("out/jobs")
CLUSTER: TypeAlias = Annotated[
    str | None, typer.Option(help="Work on a cluster instead: the address of its Dask scheduler, tcp://HOST:PORT.")
]


def workers_of(processes: int, cluster: str | None) -> Workers:
    """Those of a cluster, if its address is given; otherwise the processes of this machine.

    Raises ConfigurationError when nothing answers at the address, or Dask is not installed.
    """
    if cluster is None:
        return here(processes)
    from evaluation.jobs.cluster import check_cluster, over_cluster  # noqa: PLC0415  an extra

    check_cluster(cluster)
    return partial(over_cluster, cluster)
