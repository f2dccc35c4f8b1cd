"""A consumer, a daemon and a zenoh router in processes of their own, of other users too, which are this file."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from autoexpose_daemon.client import ReceivedPair, StereoClient

READY_S = 30.0
QUIET = {"multicast": {"enabled": False}}


def consume(options: dict[str, Any]) -> None:
    """Say when the first pair is there, and at the end of the input what came."""
    client = StereoClient(
        options["rig"], options["connect"] or None, options["file"] and Path(options["file"]), name=options["name"]
    )

    def close_at_the_end_of_input() -> None:
        sys.stdin.read()
        client.close()

    threading.Thread(target=close_at_the_end_of_input, daemon=True).start()
    sequences: list[int] = []
    latencies_ms: list[float] = []
    for pair in client:
        if not sequences:
            print("ready", flush=True)
        sequences.append(pair.sequence)
        latencies_ms.append(latency_ms(pair))
    percentiles = np.percentile(latencies_ms, [50, 99]).round(3).tolist() if latencies_ms else None
    print(json.dumps({"tally": asdict(client.tally), "latency_ms": percentiles, "sequences": sequences}))


def latency_ms(pair: ReceivedPair) -> float:
    """From the daemon having both frames to this process having the pair; on one machine only."""
    assert pair.right is not None
    return (pair.received_ns - max(pair.left.arrival_time_ns, pair.right.arrival_time_ns)) * 1e-6


def serve() -> None:
    """A daemon on scripted cameras, which publishes where daemons do unless configured otherwise."""
    from tests.autoexpose_daemon.scripted import scripted_daemon  # noqa: PLC0415  takes a second

    with scripted_daemon(None, publish={}) as (daemon, _, _):
        while (tally := daemon.telemetry.publishing) is None or not tally.sent:
            threading.Event().wait(0.01)
        print("ready", flush=True)
        sys.stdin.read()


def route(file: str) -> None:
    """A session with `mode: router`, configured by the file that is named."""
    with zenoh.open(zenoh.Config.from_file(file)):
        print("ready", flush=True)
        sys.stdin.read()


@dataclass(frozen=True, slots=True)
class Account:
    """A user, by numbers: one need not exist to run a process."""

    uid: int
    gid: int
    groups: tuple[int, ...] = ()

    def starts(self) -> dict[str, Any]:
        """How `subprocess` starts a process of this user."""
        return {"user": self.uid, "group": self.gid, "extra_groups": self.groups}


class Consumer:
    """The other end, for a test."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def wait_for_first(self) -> None:
        """Until it has its first pair."""
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def result(self) -> dict[str, Any]:
        """End it, and what it got."""
        out, _ = self.process.communicate(timeout=READY_S)
        got: dict[str, Any] = json.loads(out.splitlines()[-1])
        return got


@contextlib.contextmanager
def _running(what: str, argument: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-B", "-m", "tests.autoexpose_daemon.publish.processes", what, argument]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options) as process:
        try:
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def consumer(
    name: str, *connect: str, rig: str = "rig", file: Path | None = None, account: Account | None = None
) -> Iterator[Consumer]:
    options = {"name": name, "connect": connect, "rig": rig, "file": file and str(file)}
    with _running("consumer", json.dumps(options), **(account.starts() if account else {})) as process:
        yield Consumer(process)


@contextlib.contextmanager
def service(folder: Path, account: Account | None = None) -> Iterator[subprocess.Popen[str]]:
    """A daemon with the folder and the umask that its unit gives it, once it publishes."""
    options = {"umask": 0o027, "env": os.environ | {"RUNTIME_DIRECTORY": str(folder)}}
    with _running("service", "", **options, **(account.starts() if account else {})) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process


@contextlib.contextmanager
def router(file: Path) -> Iterator[None]:
    with _running("router", str(file)) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield


def router_file(folder: Path, at: str, **more: Any) -> Path:
    """The configuration of a router that listens there."""
    file = folder / "router.json5"
    file.write_text(json.dumps({"mode": "router", "listen": {"endpoints": [at]}, "scouting": QUIET, **more}))
    return file


if __name__ == "__main__":
    match sys.argv[1]:
        case "consumer":
            consume(json.loads(sys.argv[2]))
        case "service":
            serve()
        case _:
            route(sys.argv[2])
