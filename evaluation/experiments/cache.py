"""Jobs whose results are not kept yet are run; each result is kept by a hash of what made it."""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import json
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, PLACES
from evaluation.arena.count import c_files
from evaluation.experiments.experiment import Job, Plain
from evaluation.long_runs import KeptResults
from evaluation.pool import over_processes

_OURS = (
    "autoexpose_daemon", "calibration", "documents", "drivers", "evaluation", "fake_camera", "imaging", "navigation"
)  # fmt: skip
_LIBRARIES = ("numpy", "opencv-python-headless", "numba", "evo")


class ResultCache(KeptResults[Job]):
    """One file for each job, named by a hash of its function, its arguments and all of our code that it can reach. So a
    stopped run resumes where it was, and after a change of code only what that code affects is measured again."""

    def key(self, asked: Job) -> str:
        """Equal for jobs that have the same result."""
        policies = tuple(PLACES) if asked.policies is None else asked.policies
        digest = _digest(asked.measure.__module__, policies)
        parts = [asked.measure.__module__, asked.measure.__qualname__, asked.arguments, digest]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


# Loads policies by their names, so no import statement leads to them.
_TABLE = "autoexpose_daemon.control.policies.table"
_IDS = "autoexpose_daemon.control.policies.ids"  # Lists them: another policy in it changes no result of the others


@cache
def _digest(module: str, policies: tuple[str, ...] = tuple(PLACES)) -> str:
    """Of the sources that a module reaches, and of the versions of the libraries that produce numbers. It reaches what
    it imports, the C that this calls and, where it reaches the table of policies, those with these ids."""
    reached: dict[str, Path] = {}
    ahead = [module]
    while ahead:
        name = ahead.pop()
        if name in reached or name.split(".")[0] not in _OURS or (path := _source(name)) is None:
            continue
        reached[name] = path
        ahead += [".".join(name.split(".")[:depth]) for depth in range(1, name.count(".") + 1)]
        ahead += _imports(path)
        if name == _TABLE:
            ahead += [f"{_TABLE.rpartition('.')[0]}.{PLACES[policy].rpartition('.')[0]}" for policy in policies]
    state = hashlib.sha256()
    for name in sorted(reached):
        if name != _IDS:
            state.update(name.encode() + b"\0" + reached[name].read_bytes() + b"\0")
        for weights in sorted(reached[name].parent.glob("*.npz")):  # of learned policies
            state.update(weights.read_bytes())
    for path in c_files(list(reached.values())):
        state.update(path.read_bytes())
    state.update(repr([DEFAULT_POLICY, *((policy, PLACES[policy]) for policy in policies)]).encode())
    for library in _LIBRARIES:
        state.update(f"{library} {_version(library)}".encode())
    return state.hexdigest()


def _version(library: str) -> str:
    """Of an installed library; an absent one does not stop jobs that do not need it."""
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def _source(module: str) -> Path | None:
    """The file of a module; None for a name that is not a module."""
    try:
        spec = find_spec(module)
    except ModuleNotFoundError:
        return None
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None


@cache
def _imports(path: Path) -> tuple[str, ...]:
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Import(names=aliases):
                names += [alias.name for alias in aliases]
            case ast.ImportFrom(module=str(module), names=aliases):
                names += [module, *(f"{module}.{alias.name}" for alias in aliases)]
    return tuple(names)


def plain(value: Any) -> Plain:
    """A result as it will be read from disk, so that fresh and kept results are the same."""
    kept: Plain = json.loads(json.dumps(value))
    return kept


# Called with each finished job and how long it took (s; 0 when its result was kept).
Advance = Callable[[Job, float], None]


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
