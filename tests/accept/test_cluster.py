"""The same bytes from this machine and from a cluster whose workers are killed."""

from __future__ import annotations

import contextlib
import json
import random
import threading
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from rich.console import Console

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from benchmarks.bench_rejudge import DriveToMake, local_cluster, make
from evaluation.experiments.worth import worth
from evaluation.jobs.cluster import connected
from evaluation.jobs.job import Job
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import run_jobs, workers_of
from evaluation.rejudge import fleet, segments
from evaluation.rejudge.decide import Margins
from evaluation.rejudge.following import IN_HOUSE

KILLS = 20


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with local_cluster(2) as at:
        yield at


@contextlib.contextmanager
def killing(address: str, kills: int) -> Iterator[list[int]]:
    """Meanwhile, workers are killed, each up to a second after work was seen to be going on."""
    killed: list[int] = []
    end, chance = threading.Event(), random.Random(kills)

    def kill() -> None:
        with connected(address) as client:
            while len(killed) < kills and not end.is_set():
                busy = any(client.processing().values())
                if not end.wait(chance.random()) and busy and (workers := workers_here()):
                    with contextlib.suppress(psutil.NoSuchProcess):  # gone since
                        chance.choice(workers).kill()
                        killed.append(len(killed))

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        end.set()
        thread.join()


def workers_here() -> list[psutil.Process]:
    """The processes that work, not those that watch over them."""
    found = []
    for one in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):  # gone since, or a zombie
            if "spawn_main" in " ".join(one.cmdline()):
                found.append(one)
    return found


def bytes_in(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*.json")}


@pytest.mark.timeout(900)
def test_rejudge_gives_the_same_bytes_however_often_workers_die(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive in segments of a second."""
    monkeypatch.setattr(segments, "SEGMENT_S", 1.0)
    asked = [DriveToMake(number, 3.9, 20.0, tmp_path) for number in range(1)]
    for drive in asked:
        make(drive)

    def judged(cluster: str | None) -> str:
        found = fleet.judge(
            [drive.path for drive in asked], ["fixed", "neves2009"], present="fixed", by=None, groups={},
            odometry=IN_HOUSE, trajectory=None, margins=Margins(), kept=ResultCache(tmp_path / str(cluster is None)),
            workers=workers_of(1, cluster), console=Console(quiet=True),
        )  # fmt: skip
        return json.dumps(found.document())

    with killing(address, KILLS) as killed:
        there = judged(address)
    assert len(killed) == KILLS
    assert there == judged(None)
    assert bytes_in(tmp_path / "False") == bytes_in(tmp_path / "True") and len(bytes_in(tmp_path / "True")) == 1 + 8


@pytest.mark.timeout(900)
def test_worth_gives_the_same_bytes_however_often_workers_die(address: str, tmp_path: Path) -> None:
    """A part of what a quick run measures: all contenders through a course of matches, and the default elsewhere."""

    def run(jobs: list[Job], cluster: str | None) -> None:
        run_jobs(jobs, ResultCache(tmp_path / str(cluster is None)), workers_of(1, cluster), lambda *_: None)

    every = worth.jobs(True)
    course = next(job.arguments["course"] for job in every if job.cost_s < 2.0)
    some = [job for job in every if job.arguments.get("course") == course and job.cost_s < 2.0]
    some += [
        job for job in every if job.cost_s < 10.0 and (job.policies or ("",))[0] == DEFAULT_POLICY and job.cost_s > 2
    ]
    assert len({job.measure.__module__ for job in some}) == 3
    with killing(address, KILLS) as killed:
        run(some, address)
    assert len(killed) > KILLS / 2
    run(some, None)
    assert bytes_in(tmp_path / "False") == bytes_in(tmp_path / "True") and len(bytes_in(tmp_path / "True")) == len(some)
