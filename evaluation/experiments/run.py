"""Does the jobs of experiments that are not kept from earlier, over processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing

from evaluation.experiments.cache import ResultCache, plain
from evaluation.experiments.experiment import Job, Plain
from evaluation.pool import over_processes

Advance = Callable[[Job, float], None]
"""Told of each job that is done, and how long it took (s; 0: it was kept)."""


def run_jobs(jobs: Sequence[Job], kept: ResultCache, processes: int, advance: Advance) -> list[Plain]:
    """The results of all jobs, in their order; each is kept as soon as it is there."""
    results: dict[int, Plain] = {}
    missing: list[tuple[int, Job]] = []
    for place, job in enumerate(jobs):
        known = kept.get(job)
        if known is None:
            missing.append((place, job))
        else:
            results[place] = known[0]
            advance(job, 0.0)
    missing.sort(key=lambda entry: -entry[1].cost_s)
    with closing(over_processes(_measure, missing, min(processes, max(len(missing), 1)))) as finished:
        for (place, job), (result, took_s) in finished:
            kept.put(job, result)
            results[place] = plain(result)
            advance(job, took_s)
    return [results[place] for place in range(len(jobs))]


def _measure(entry: tuple[int, Job]) -> tuple[Plain, float]:
    begun_s = time.perf_counter()
    result = entry[1].measure(**entry[1].arguments)
    return result, time.perf_counter() - begun_s
