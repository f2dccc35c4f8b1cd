"""Runs those jobs of experiments whose results are not kept from earlier."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing

from evaluation.experiments.cache import ResultCache, plain
from evaluation.experiments.experiment import Job, Plain
from evaluation.pool import over_processes

Advance = Callable[[Job, float], None]
"""Called with each finished job and how long it took (s; 0 when its result was kept)."""


def run_jobs(jobs: Sequence[Job], kept: ResultCache, processes: int, advance: Advance) -> list[Plain]:
    """The results of all jobs, in their order; each is saved when it is ready, and equal jobs run once."""
    results: dict[int, Plain] = {}
    missing: dict[str, list[int]] = {}
    for place, job in enumerate(jobs):
        known = kept.get(job)
        if known is None:
            missing.setdefault(kept.key(job), []).append(place)
        else:
            results[place] = known[0]
            advance(job, 0.0)
    entries = [(places, jobs[places[0]]) for places in missing.values()]
    entries.sort(key=lambda entry: -entry[1].cost_s)
    with closing(over_processes(_measure, entries, min(processes, max(len(entries), 1)))) as finished:
        for (places, job), (result, took_s) in finished:
            kept.put(job, result)
            for place in places:
                results[place] = plain(result)
                advance(jobs[place], took_s if place == places[0] else 0.0)
    return [results[place] for place in range(len(jobs))]


def _measure(entry: tuple[list[int], Job]) -> tuple[Plain, float]:
    begun_s = time.perf_counter()
    result = entry[1].measure(**entry[1].arguments)
    return result, time.perf_counter() - begun_s
