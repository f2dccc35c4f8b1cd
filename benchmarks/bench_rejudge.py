"""What it costs to judge a fleet: processor time, storage and network, on a cluster of this machine's processes.

Makes short drives in virtual time (twice through each course, with other noise), and judges them on a Dask cluster of
two workers. Network is what the loopback interface carried: run it where nothing else uses that, such as in a network
of its own:

    unshare -rn sh -c 'ip link set lo up; exec .venv/bin/python -m benchmarks.bench_rejudge --json OUT.json'

Drives and results stay in `--folder`, so that a stopped run goes on; remove it afterwards: 0.15 GB for each drive.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.recording.file import RecordingFile, Step
from evaluation.experiments.rejudge import DELAY_FRAMES, simulated_geometries, simulated_setup
from evaluation.jobs.cluster import connected, over_cluster
from evaluation.jobs.kept import ResultCache
from evaluation.odometry.tracking import PERIOD_S, Light, lap, odometry_stage
from evaluation.pool import over_processes
from evaluation.rejudge.decide import Margins
from evaluation.rejudge.fleet import JudgedFleet, judge
from evaluation.rejudge.following import IN_HOUSE
from evaluation.stage.camera import DelayedLoop
from imaging.frames import FrameSet

LIGHTS: Sequence[Light] = ("uneven", "low", "even", "faint")
FIRST_ROOM = 400
COURSES_PER_ROOM = 5
BEGIN_S = 8.0  # in full motion
START_S = 120.0  # Longest that a process of Dask may take to start on a busy machine
PARTLY = 10  # One drive in so many is also judged for a single policy, which tells what policies share
ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {
    "PYTHONPATH": str(ROOT),
    "DASK_DISTRIBUTED__NANNY__PRELOAD": "",
    "DASK_DISTRIBUTED__WORKER__DAEMON": "False",
}


@dataclass(frozen=True, slots=True)
class DriveToMake:
    """A drive of the simulated rig."""

    number: int  # two in a row have one course, and other noise
    seconds: float
    rate_hz: float
    folder: Path

    @property
    def path(self) -> Path:
        """Its recording."""
        return self.folder / f"course{self.number // 2:03d}-{self.number % 2}.mcap"


def make(drive: DriveToMake) -> None:
    """Drive and record, unless that has been done. The robot is as slow as its frames are few."""
    if drive.path.exists():
        return
    course = drive.number // 2
    room, light = FIRST_ROOM + course // COURSES_PER_ROOM, LIGHTS[course % len(LIGHTS)]
    stage = odometry_stage(light, room, course, drive.number % 2)
    slowly = lap(course, PERIOD_S * 60.0 / drive.rate_hz)
    for view in stage.views.values():
        view._path = slowly  # type: ignore[attr-defined]
    frames = round(drive.seconds * drive.rate_hz) + 1
    stage._start_times_s = BEGIN_S + np.arange(frames) / drive.rate_hz
    setup = simulated_setup(Bracketing())
    delayed = DelayedLoop(ControlLoop(setup), DELAY_FRAMES)
    unfinished = drive.path.with_suffix(".part")
    unfinished.unlink(missing_ok=True)
    file = RecordingFile(unfinished, f"rig{drive.number % 2}")
    for number in range(frames):
        stage.go_to(number)
        pair = delayed.step(stage.take)
        copies = {camera: replace(frame, pixels=frame.pixels.copy()) for camera, frame in pair.frames.items()}
        inputs = StepInputs(FrameSet(number, copies))
        step = Step(number + 1, 2, inputs, delayed.decisions[-1], calibrations=simulated_geometries())
        file.write(step, setup, delayed.loop.state() if number == 0 else None)
    file.close(frames, 0)
    unfinished.rename(drive.path)


@contextlib.contextmanager
def local_cluster(workers: int, threads: int = 1) -> Iterator[str]:
    """The address of a scheduler with workers, all of them processes of this machine. Killed ones come again."""
    with contextlib.ExitStack() as running:

        def start(*command: str) -> str:
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{command[0]}", *command[1:], "--no-dashboard"],
                cwd=ROOT, env={**os.environ, **ENVIRONMENT}, stderr=subprocess.PIPE, text=True, start_new_session=True,
            )  # fmt: skip
            places: queue.Queue[str] = queue.Queue()
            reading = threading.Thread(target=_read, args=(process, places.put))
            reading.start()
            running.callback(reading.join)
            running.callback(process.wait)
            running.callback(os.killpg, process.pid, signal.SIGKILL)
            return places.get(timeout=START_S)

        address = start("scheduler", "--host", "127.0.0.1", "--port", "0")
        options = ("--nworkers", str(workers), "--nthreads", str(threads), "--host", "127.0.0.1")
        start("worker", address, *options)
        with connected(address) as client:
            client.wait_for_workers(workers)
        yield address


def _read(process: subprocess.Popen[str], found: Callable[[str], None]) -> None:
    """Say where a process of Dask is; and read on, for its pipe must not be full when it is killed often."""
    assert process.stderr is not None
    with process.stderr as lines:
        for line in lines:
            if "Scheduler at:" in line or "Registered to:" in line:
                found(line.split()[-1])


def loopback_bytes() -> int:
    """Received so far over the loopback interface."""
    lines = Path("/proc/net/dev").read_text(encoding="utf-8").splitlines()
    return int(next(line for line in lines if line.strip().startswith("lo:")).split(":")[1].split()[0])


def size_bytes(folder: Path) -> int:
    """Of all files in it."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one fleet that was judged."""

    worker_cpu_s: float
    own_cpu_s: float
    wall_s: float
    network_bytes: int
    kept_bytes: int


def judged(
    address: str, drives: Sequence[Path], policies: Sequence[str], kept: Path, console: Console
) -> tuple[JudgedFleet, Cost]:
    """A fleet, and what it cost; all workers must have come."""
    with connected(address) as client:

        def used_s() -> float:
            return float(sum(client.run(time.process_time).values()))

        before = used_s(), time.process_time(), time.perf_counter(), loopback_bytes()
        fleet = judge(
            drives, policies, present=policies[0], by=None, groups={}, odometry=IN_HOUSE, trajectory=None,
            margins=Margins(), kept=ResultCache(kept), workers=partial(over_cluster, address), console=console,
        )  # fmt: skip
        after = used_s(), time.process_time(), time.perf_counter(), loopback_bytes()
    spent = [later - earlier for earlier, later in zip(before, after, strict=True)]
    return fleet, Cost(spent[0], spent[1], spent[2], int(spent[3]), size_bytes(kept))


def minutes_of(fleet: JudgedFleet) -> float:
    """How long it drove."""
    return sum(drive.seconds for drive in fleet.drives) / 60.0


def figures_of(fleet: JudgedFleet, all_of_it: Cost, partly: JudgedFleet, some: Cost) -> Mapping[str, Any]:
    """By the minute of driving. `partly`: some drives, for the first policy alone, and what they cost."""
    minutes, some_minutes = minutes_of(fleet), minutes_of(partly)
    pairs = sum(len(drive.survey.times_s) for drive in fleet.drives)
    whole, single = all_of_it.worker_cpu_s / minutes, some.worker_cpu_s / some_minutes
    each = (whole - single) / (len(fleet.policies) - 1)
    recorded = sum(drive.path.stat().st_size for drive in fleet.drives)
    return {
        "drives": len(fleet.drives), "minutes": minutes, "pairs": pairs, "policies": list(fleet.policies),
        "worker_cpu_s_per_minute": whole, "of_which_each_policy": each, "of_which_shared": single - each,
        "worker_cpu_ms_per_pair": 1e3 * all_of_it.worker_cpu_s / pairs,
        "own_cpu_s": all_of_it.own_cpu_s, "wall_s": all_of_it.wall_s,
        "recorded_mb_per_minute": recorded / 1e6 / minutes, "kept_mb_per_minute": all_of_it.kept_bytes / 1e6 / minutes,
        "network_mb_per_minute": all_of_it.network_bytes / 1e6 / minutes, "decision": fleet.decision().why,
        "rows": rows_of(fleet),
    }  # fmt: skip


def rows_of(fleet: JudgedFleet) -> Mapping[str, Any]:
    """By policy, what decides: the drive, the error of odometry (mm), the share of lost pairs, and matches."""
    return {
        policy: [
            [Path(one.drive).stem, one.rpe_mm, one.lost_share, one.matches]
            for drive in fleet.drives
            for one in drive.seen(policy)
        ]
        for policy in fleet.policies
    }


def main() -> None:
    """Make drives, judge them, and print what that cost."""
    parser = argparse.ArgumentParser(description=str(__doc__), formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate-hz", type=float, default=20.0)
    parser.add_argument("--policies", default="belief,begin2022-code,fixed", help="at least two")
    parser.add_argument("--folder", type=Path, default=Path("out/fleet"))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only-make", action="store_true", help="only record the drives")
    given = parser.parse_args()
    folder: Path = given.folder
    (folder / "drives").mkdir(parents=True, exist_ok=True)
    asked = [DriveToMake(number, given.seconds, given.rate_hz, folder / "drives") for number in range(given.drives)]
    for drive, _ in over_processes(make, asked, 2):
        print(f"{time.strftime('%H:%M:%S')} {drive.path.name}", flush=True)
    if given.only_make:
        return
    paths, policies, console = [drive.path for drive in asked], given.policies.split(","), Console()
    few = paths[::PARTLY]
    with local_cluster(2) as address:
        fleet, everything = judged(address, paths, policies, folder / "kept", console)
        partly, some = judged(address, few, policies[:1], folder / "kept-single", console)
    found = figures_of(fleet, everything, partly, some)
    print(json.dumps({name: value for name, value in found.items() if name != "rows"}, indent=1))
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
