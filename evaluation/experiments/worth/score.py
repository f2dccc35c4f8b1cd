"""Scores contenders on tuning scenes, while they are developed: the first is compared with the others.

    python -m evaluation.experiments.worth.score NAME NAME ... [--judge odometry|matches] [--part N] [--jobs N]

Names are ids of policies (a new one needs its line in `control/policies/ids.py`) or other `CONTENDERS`. Finished jobs
are kept with those of `autoexpose experiments`, and shared with `worth-tuning`."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from evaluation.experiments.worth import odometry_judge
from evaluation.experiments.worth.contenders import CONTENDERS
from evaluation.experiments.worth.matches import judge as matches_judge
from evaluation.experiments.worth.matches.courses import courses
from evaluation.experiments.worth.odometry_judge import drives
from evaluation.experiments.worth.tables import claims_tables, means_tables
from evaluation.experiments.worth.worth import verdicts_of
from evaluation.jobs.job import Job
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import FINISHED, here, run_jobs


def main() -> None:
    """Print means and comparisons."""
    parser = argparse.ArgumentParser(description="Scores contenders on tuning scenes.")
    parser.add_argument("names", nargs="+", choices=CONTENDERS, metavar="NAME")
    parser.add_argument("--judge", choices=("odometry", "matches"), default="odometry")
    parser.add_argument("--part", type=int, default=1, help="every how many of the tuning scenes: 1 for all")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--kept", type=Path, default=FINISHED, help="folder for what is finished")
    given = parser.parse_args()
    if given.judge == "odometry":
        every, size = drives("tuning"), odometry_judge.GROUP
        some = [drive for place, drive in enumerate(every) if place // size % given.part == 0]
        jobs = odometry_judge.contender_jobs(some, given.names)
    else:
        jobs = matches_judge.contender_jobs(courses("tuning")[:: given.part], given.names)
    took: dict[str, float] = {}

    def advance(job: Job, took_s: float) -> None:
        name = str(job.arguments["contender"])
        took[name] = took.get(name, 0.0) + took_s
        print(f"{time.strftime('%H:%M:%S')} {name} {took_s:.0f} s", flush=True)

    found = run_jobs(jobs, ResultCache(given.kept), here(given.jobs), advance)
    verdicts = verdicts_of([(job.arguments, rows) for job, rows in zip(jobs, found, strict=True)])
    first, *others = given.names
    for table in (*means_tables(verdicts), *claims_tables(verdicts, others, first)):
        print(f"\n{table.caption}\n" + "\n".join(" | ".join(row) for row in (table.heads, *table.rows)))
    print("\nseconds of one core:", {name: round(seconds) for name, seconds in took.items()})


if __name__ == "__main__":
    main()
