"""A day of the daemon in virtual time; ``make soak`` runs it.

Exits with 1 when anything is wrong: then it names the minute, its fault, and what did not fit.
"""

from __future__ import annotations

import argparse
import gc
import logging
import os
import random
import sys
import time
from collections import Counter, deque
from dataclasses import dataclass
from pathlib import Path

from autoexpose_daemon.demo.fakes import MOST_CAMERAS
from imaging.python310 import Self
from tests.soak.clock import SECOND
from tests.soak.day import Day, LogCounter

GROWTH_BYTES = 1 << 20
GROWTH_ELEMENTS = 500
"""What the second half may add: caches of Python and the heap breathe a little, but the day has 5 million triggers."""

WARM_UP_HOURS = 1
"""The longest memory of telemetry is full by then."""


@dataclass(frozen=True, slots=True)
class Memory:
    """Resident bytes, and how many elements all containers that Python's collector knows of have together."""

    resident_bytes: int
    elements: int

    @classmethod
    def now(cls) -> Self:
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        containers = (each for each in gc.get_objects() if isinstance(each, list | dict | set | deque))
        return cls(pages * os.sysconf("SC_PAGESIZE"), sum(map(len, containers)))


def main() -> int:
    """Run it; the exit code."""
    arguments = _arguments()
    log = LogCounter()
    product = [logging.getLogger(name) for name in ("autoexpose_daemon", "drivers")]
    for logger in product:
        logger.setLevel(logging.INFO)
        logger.addHandler(log)
        logger.propagate = False
    print(
        f"soak: {arguments.hours:g} h of virtual time, {arguments.cameras} cameras, seed {arguments.seed}", flush=True
    )
    began_s = time.monotonic()
    day = Day(arguments.seed, log, arguments.cameras)
    minutes = round(60 * arguments.hours)
    totals: Counter[str] = Counter()
    faults: Counter[str] = Counter()
    wrong, slowest_ns = 0, 0
    middle: Memory | None = None
    for number, minute in enumerate(day.minutes(minutes), 1):
        totals.update(minute.counts)
        faults[minute.fault] += 1
        slowest_ns = max(slowest_ns, minute.recovered_ns)
        for what in minute.wrong:
            wrong += 1
            print(f"minute {number}, {minute.fault}: {what}", flush=True)
        if number == max(minutes // 2, 60 * WARM_UP_HOURS):
            middle = Memory.now()
        if number % 60 == 0:
            print(
                f"{number // 60:3} h: {day.wire.triggers} triggers, {totals['pairs']} pairs, "
                f"{Memory.now().resident_bytes / 1e6:.1f} MB, {_spent(began_s)}",
                flush=True,
            )
    account = day.close()
    if account is not None:
        wrong += 1
        print(account)
    wrong += _grown(middle)
    _table(day, totals, faults, slowest_ns)
    print(f"{_spent(began_s)}; {wrong or 'nothing'} wrong")
    return 1 if wrong else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="of virtual time")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6), help="of faults and jitter")
    parser.add_argument("--cameras", type=int, choices=range(2, MOST_CAMERAS + 1), default=2, help="in groups of two")
    return parser.parse_args()


def _spent(began_s: float) -> str:
    return f"{time.monotonic() - began_s:.0f} s ({time.process_time():.0f} s of the processor)"


def _grown(middle: Memory | None) -> int:
    if middle is None:
        print(f"memory: not judged, that takes more than {WARM_UP_HOURS} h")
        return 0
    end = Memory.now()
    grown_bytes, grown = end.resident_bytes - middle.resident_bytes, end.elements - middle.elements
    print(f"memory: {end.resident_bytes / 1e6:.1f} MB; the second half added {grown_bytes} bytes, {grown} elements")
    return int(grown_bytes > GROWTH_BYTES) + int(grown > GROWTH_ELEMENTS)


def _table(day: Day, totals: Counter[str], faults: Counter[str], slowest_ns: int) -> None:
    print(f"faults: {', '.join(f'{count} {name}' for name, count in sorted(faults.items()))}")
    for name, count in [("triggers", day.wire.triggers), *totals.items()]:
        if count:
            print(f"{name:>16} {count:8}")
    print(f"slowest recovery after the cause of a fault: {slowest_ns / SECOND:.1f} s")


if __name__ == "__main__":
    sys.exit(main())
