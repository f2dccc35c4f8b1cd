"""Run the tests of `make test` repeatedly and sum up: `make test-again N=20`, `make test-again N=5 BUSY=1`.

Each run is a line of JSON in out/test-again.log. Earlier runs of the same commit count, so an interrupted series
continues. The output of red runs is kept in out/test-again/.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from autoexpose_daemon.demo.reference_step import reference_step_ms

LOG = Path("out/test-again.log")
KEPT = Path("out/test-again")
SUITE = ["make", "--no-print-directory", "suite"]
LIMIT_S = 360.0
YARDSTICK_MS = 4.0
"""A machine whose literal step takes this long has `LIMIT_S`; a faster one has less, in proportion."""

REPEATS = 50
BUSY = "import os, sys\nwhile os.getppid() == int(sys.argv[1]):\n    sum(range(10**6))"


@dataclass(frozen=True)
class Run:
    """One run of the suite: date, commit, duration and results."""

    date: str
    commit: str
    busy: bool
    seconds: float
    literal_step_ms: float
    passed: int
    skipped: int
    failed: list[str]

    @property
    def share(self) -> float:
        """The share of the time that a machine of this speed has."""
        return self.seconds / (LIMIT_S * self.literal_step_ms / YARDSTICK_MS)


def read(log: Path) -> list[Run]:
    """All runs of a log."""
    return [Run(**json.loads(line)) for line in log.read_text().splitlines()] if log.exists() else []


def results(output: str, code: int) -> tuple[int, int, list[str]]:
    """How many passed and were skipped, and what failed, from the output of pytest and make."""
    counts: Counter[str] = Counter()
    for line in re.findall(r"^=*\s*((?:\d+ \w+, )*\d+ \w+) in [\d.]+s.*$", output, re.MULTILINE):
        counts.update({what: int(count) for count, what in re.findall(r"(\d+) (\w+)", line)})
    failed = re.findall(r"^(?:FAILED|ERROR) (tests/\S+)", output, re.MULTILINE)  # log lines begin with their level, too
    if code and not failed:
        failed = [f"make ended with {code}"]
    return counts["passed"], counts["skipped"], failed


def summary(runs: Sequence[Run]) -> list[str]:
    """A summary in sentences; runs with a busy core are listed separately."""
    sentences = []
    for busy in (False, True):
        of_kind = [run for run in runs if run.busy == busy]
        if not of_kind:
            continue
        green = sum(not run.failed for run in of_kind)
        seconds, steps_ms = [run.seconds for run in of_kind], [run.literal_step_ms for run in of_kind]
        sentences.append(
            f"{green} of {len(of_kind)} green{' with one core kept busy' if busy else ''}, "
            f"{_minutes(min(seconds))} to {_minutes(max(seconds))}, "
            f"literal step {min(steps_ms):.1f} to {max(steps_ms):.1f} ms: "
            f"at most {100 * max(run.share for run in of_kind):.0f} % of the limit, 6 min x literal step / 4 ms"
        )
        for name, times in Counter(name for run in of_kind for name in run.failed).most_common():
            sentences.append(f"failed {times} times: {name}")
    return sentences


def _minutes(seconds: float) -> str:
    return f"{round(seconds) // 60}:{round(seconds) % 60:02}"


@contextlib.contextmanager
def busy_core(busy: bool) -> Iterator[None]:
    """Keep one core busy with another process, if asked to; it ends with this one."""
    if not busy:
        yield
        return
    with subprocess.Popen([sys.executable, "-c", BUSY, str(os.getpid())]) as process:
        try:
            yield
        finally:
            process.kill()


def run_once(commit: str, busy: bool) -> Run:
    """Run the suite; its output is kept if it is red."""
    date = datetime.now().astimezone().isoformat(timespec="seconds")
    with busy_core(busy):
        before_ms, began_s = reference_step_ms(REPEATS), time.monotonic()
        made = subprocess.run(SUITE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        seconds, after_ms = time.monotonic() - began_s, reference_step_ms(REPEATS)
    passed, skipped, failed = results(made.stdout, made.returncode)
    if failed:
        KEPT.mkdir(parents=True, exist_ok=True)
        (KEPT / f"{date.replace(':', '')}.txt").write_text(made.stdout)
    step_ms = round((before_ms + after_ms) / 2, 2)
    return Run(date, commit, busy, round(seconds, 1), step_ms, passed, skipped, failed)


def main() -> int:
    """Run until there are enough runs; returns 1 if one was red or too slow."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="how many runs of this commit are wanted (%(default)s)")
    parser.add_argument("--busy", action="store_true", help="keep one core busy with another process meanwhile")
    options = parser.parse_args()
    describe = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    commit = subprocess.run(describe, capture_output=True, text=True, check=True).stdout.strip()
    LOG.parent.mkdir(exist_ok=True)
    while (done := sum(run.commit == commit and run.busy == options.busy for run in read(LOG))) < options.runs:
        run = run_once(commit, options.busy)
        with LOG.open("a") as log:
            log.write(json.dumps(asdict(run)) + "\n")
        outcome = (
            f"RED: {', '.join(run.failed)}" if run.failed else f"green, {run.passed} passed, {run.skipped} skipped"
        )
        print(
            f"{done + 1} of {options.runs}: {outcome}; {_minutes(run.seconds)}, {100 * run.share:.0f} % of the limit "
            f"at a literal step of {run.literal_step_ms} ms",
            flush=True,
        )
    runs = [run for run in read(LOG) if run.commit == commit]
    print(f"{commit}:", *summary(runs), sep="\n")
    asked = [run for run in runs if run.busy == options.busy]
    too_slow = not options.busy and any(run.share > 1 for run in asked)
    return int(too_slow or any(run.failed for run in asked))


if __name__ == "__main__":
    sys.exit(main())
