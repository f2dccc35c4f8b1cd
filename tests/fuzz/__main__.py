"""All targets under atheris, two at a time: ``python -m tests.fuzz [TARGET ...]``; ``make fuzz`` runs it.

Each target ends after a time, a number of inputs, or its first finding, which is printed as a Python literal to paste
into found.py. The corpus stays in build/fuzz, and the next run goes on from it.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import re
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import atheris

from tests.fuzz.target import Target
from tools.stage_package import ROOMS

PACKAGES = [room for room in ROOMS if room != "evaluation"]

with contextlib.redirect_stderr(io.StringIO()), atheris.instrument_imports(include=PACKAGES):
    from tests.fuzz.targets import TARGETS

BUILD = Path("build/fuzz")
INPUTS = 1_000_000
SECONDS = 50
AT_ONCE = 2
SHORTEN_S = 20
OPTIONS = (
    f"-runs={INPUTS}",
    f"-max_total_time={SECONDS}",
    "-timeout=10",  # s for one input
    "-rss_limit_mb=2048",
    "-max_len=20000",
    "-print_final_stats=1",
)
ARTIFACTS = ("crash-*", "timeout-*", "oom-*")


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a target did; `findings` are words, each with the input as a literal."""

    name: str
    inputs: int
    seconds: float
    edges: int
    findings: tuple[str, ...]

    def __str__(self) -> str:
        said = f"{len(self.findings)} FOUND" if self.findings else "nothing found"
        return f"{self.name:16}{self.inputs:>10} inputs{self.seconds:6.0f} s{self.edges:7} edges   {said}"


def run(targets: Sequence[Target]) -> Iterator[Outcome]:
    """Fuzz the targets in processes of their own; the outcomes as they end."""
    waiting = list(targets)
    running: dict[int, tuple[Target, float]] = {}
    while waiting or running:
        while waiting and len(running) < AT_ONCE:
            target = waiting.pop(0)
            process = os.fork() or fuzz(target)
            running[process] = target, time.monotonic()
        process, status = os.wait()
        target, began_s = running.pop(process)
        yield outcome(target, time.monotonic() - began_s, status)


def fuzz(target: Target) -> NoReturn:
    """Be the process of one target."""
    folder = BUILD / target.name
    corpus, seeds = folder / "corpus", folder / "seeds"
    for place in (corpus, seeds):
        place.mkdir(parents=True, exist_ok=True)
    for old in artifacts(folder):
        old.unlink()
    log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(log, stream)
    tempfile.tempdir = str(folder.resolve())  # libFuzzer ends the process without cleaning up
    logging.disable()
    warnings.simplefilter("error", RuntimeWarning)  # of numpy, about numbers that are none
    for number, seed in enumerate(target.seeds()):
        (seeds / str(number)).write_bytes(seed)
    options = [*OPTIONS, f"-artifact_prefix={folder}/", str(corpus), str(seeds)]
    atheris.Setup([target.name, *options], target.check)
    atheris.Fuzz()
    raise SystemExit


def outcome(target: Target, seconds: float, status: int) -> Outcome:
    """What the log and the inputs that libFuzzer kept say of a run that ended with `status`."""
    folder = BUILD / target.name
    said = (folder / "log").read_text(errors="replace")
    findings = []
    for path in artifacts(folder):
        kind, data = path.name.split("-")[0], path.read_bytes()
        findings.append(f"{kind}, {cause(said)}:\n  {shortened(target, data) if kind == 'crash' else data!r}")
    if status and not findings:
        findings = [f"ended with status {status} and kept no input: see {folder}/log"]
    inputs = last_number(r"number_of_executed_units: (\d+)", said) or last_number(r"^#(\d+)", said)
    return Outcome(target.name, inputs, seconds, last_number(r"\bcov: (\d+)", said), tuple(findings))


def shortened(target: Target, data: bytes) -> bytes:
    """The input without most of what does not matter for the error."""
    error = error_of(target, data)
    deadline_s = time.monotonic() + SHORTEN_S
    size = len(data) // 2
    while size:
        start = 0
        while start < len(data) and time.monotonic() < deadline_s:
            less = data[:start] + data[start + size :]
            if error_of(target, less) == error:
                data = less
            else:
                start += size
        size //= 2
    return data


def error_of(target: Target, data: bytes) -> str:
    """What breaks and where, empty when nothing does."""
    try:
        target.check(data)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} {where.filename}:{where.lineno}"
    return ""


def artifacts(folder: Path) -> list[Path]:
    return sorted(path for pattern in ARTIFACTS for path in folder.glob(pattern))


def cause(said: str) -> str:
    """The error that ended a run, as Python or libFuzzer names it."""
    errors = re.findall(r"^(?:[\w.]*(?:Error|Exception|Warning)\b.*|==\d+== ERROR: .*)$", said, re.MULTILINE)
    return errors[0] if errors else "see its log"


def last_number(pattern: str, said: str) -> int:
    found = re.findall(pattern, said, re.MULTILINE)
    return int(found[-1]) if found else 0


def main(names: Sequence[str]) -> int:
    """Fuzz the targets of these names, all without names; 1 when something was found."""
    targets = [target for target in TARGETS if not names or target.name in names]
    print(f"{len(targets)} targets, {SECONDS} s or {INPUTS} inputs each, {AT_ONCE} at a time", flush=True)
    outcomes = []
    for number, each in enumerate(run(targets), 1):
        outcomes.append(each)
        print(f"{number:>3}/{len(targets)}  {each}", flush=True)
    for each in outcomes:
        for finding in each.findings:
            print(f"\n{each.name}: {finding}")
    print(f"\n{sum(each.inputs for each in outcomes)} inputs")
    return int(any(each.findings for each in outcomes))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
