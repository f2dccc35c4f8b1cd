"""Whether the error that a response calibration states is the one it makes, over simulated sweeps sound and spoilt.

Run with `.venv/bin/python -m benchmarks.stated_error [--processed] [--quick] [--seeds tuning|report] [--json FILE]`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import get_args

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.long_runs import LongProgress
from evaluation.pool import over_processes
from tests.calibration.simulated_sweeps import PROCESSINGS, Scene, Stated, scored, simulated

FIRST_SEED = {"tuning": 0, "report": 700_005}
"""The method was chosen on the tuning seeds; the report seeds are for docs/understand/calibration-method.md."""
FIRST_PROCESSED_SEED = {"tuning": 10_000, "report": 800_310}
"""Likewise, for images as JPEG, denoised, and in a consumer's colours."""
COUNT, QUICK = 300, 45
PROCESSED = 105
"""Every kind of sweep with every way of processing."""


def main() -> None:
    """Run, print a table by kind of sweep, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--processed", action="store_true", help=f"{PROCESSED} sweeps of cameras that process images")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} sweeps instead of {COUNT}")
    parser.add_argument("--seeds", choices=FIRST_SEED, default="tuning")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    first = (FIRST_PROCESSED_SEED if arguments.processed else FIRST_SEED)[arguments.seeds]
    count = QUICK if arguments.quick else PROCESSED if arguments.processed else COUNT
    seeds, score = range(first, first + count), of_processed_seed if arguments.processed else of_seed
    console = Console()
    results = []
    with LongProgress(console, 60.0) as progress:
        bar = progress.add_task("sweeps", total=len(seeds))
        for _, result in over_processes(score, seeds, arguments.jobs):
            results.append(result)
            progress.update(bar, advance=1)
    results.sort(key=lambda result: result.seed)
    console.print(table(results))
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(result) for result in results], indent=1))


def of_seed(seed: int) -> Stated:
    """The sweep of this seed, scored."""
    return scored(seed, simulated(seed))


def of_processed_seed(seed: int) -> Stated:
    """The same of a camera that processes its images."""
    return scored(seed, simulated(seed, processing=PROCESSINGS[seed % len(PROCESSINGS)]))


def table(results: Sequence[Stated]) -> Table:
    """A row for each kind of sweep, one for each processing of sound sweeps and kind of curve, and one for all."""
    shown = Table("sweeps", "n", "refused", "with care", "covered", "of kept", "stated", "true", "ratio", "s")
    parts = {
        kind: [result for result in results if result.kind == kind] for kind in dict.fromkeys(r.kind for r in results)
    }
    parts |= {scene: [result for result in results if result.scene == scene] for scene in get_args(Scene)}
    for processing in dict.fromkeys(result.processing for result in results):
        for linear, name in ((True, "linear"), (False, "curved")):
            parts[f"{processing}, {name}"] = [
                r for r in results if r.good and r.processing == processing and (r.curve == "linear") == linear
            ]
    for name, part in (*parts.items(), ("all", list(results))):
        if part:
            shown.add_row(name, *row(part))
    return shown


def row(part: Sequence[Stated]) -> list[str]:
    """Figures of some sweeps; medians are of those that were not refused."""
    kept = [result for result in part if result.stated_stops is not None]
    stated = np.median([result.stated_stops for result in kept]) if kept else np.nan
    true = np.median([result.true_stops for result in kept]) if kept else np.nan
    return [
        str(len(part)),
        f"{sum(result.verdict == 'refused' for result in part)}",
        f"{sum(result.verdict == 'with care' for result in part)}",
        f"{np.mean([result.covered for result in part]):.0%}",
        f"{np.mean([result.covered for result in kept]) if kept else np.nan:.0%}",
        f"{stated:.3f}",
        f"{true:.3f}",
        f"{stated / true:.1f}",
        f"{np.median([result.seconds for result in part]):.2f}",
    ]


if __name__ == "__main__":
    main()
