"""A consumer and a zenoh router in processes of their own, which are this file."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import asdict
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


def route(file: str) -> None:
    """A session with `mode: router`, configured by the file that is named."""
    with zenoh.open(zenoh.Config.from_file(file)):
        print("ready", flush=True)
        sys.stdin.read()


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
def _running(what: str, argument: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tests.autoexpose_daemon.publish.processes", what, argument]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def consumer(name: str, *connect: str, rig: str = "rig", file: Path | None = None) -> Iterator[Consumer]:
    options = {"name": name, "connect": connect, "rig": rig, "file": file and str(file)}
    with _running("consumer", json.dumps(options)) as process:
        yield Consumer(process)


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
    consume(json.loads(sys.argv[2])) if sys.argv[1] == "consumer" else route(sys.argv[2])
