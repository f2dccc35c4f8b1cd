"""A consumer in a process of its own: says when it has its first pair, and at the end of its input what it got."""

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

from autoexpose_daemon.client import ReceivedPair, StereoClient

READY_S = 30.0


def main(options: dict[str, Any]) -> None:
    client = StereoClient(
        options["rig"], options["connect"], options["file"] and Path(options["file"]), name=options["name"]
    )

    def close_at_the_end_of_input() -> None:
        sys.stdin.read()
        client.close()

    threading.Thread(target=close_at_the_end_of_input, daemon=True).start()
    sequences: list[int] = []
    latencies_ms: list[float] = []
    for pair in client:
        if not sequences:
            print("first", flush=True)
        sequences.append(pair.sequence)
        latencies_ms.append(latency_ms(pair))
    percentiles = np.percentile(latencies_ms, [50, 99]).round(3).tolist() if latencies_ms else None
    print(json.dumps({"tally": asdict(client.tally), "latency_ms": percentiles, "sequences": sequences}))


def latency_ms(pair: ReceivedPair) -> float:
    """From the daemon having both frames to this process having the pair; on one machine only."""
    assert pair.right is not None
    return (pair.received_ns - max(pair.left.arrival_time_ns, pair.right.arrival_time_ns)) * 1e-6


class Consumer:
    """The other end, for a test."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def wait_for_first(self) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "first\n"

    def result(self) -> dict[str, Any]:
        """End it, and what it got."""
        out, _ = self.process.communicate(timeout=READY_S)
        got: dict[str, Any] = json.loads(out.splitlines()[-1])
        return got


@contextlib.contextmanager
def consumer(name: str, *connect: str, rig: str = "rig", file: Path | None = None) -> Iterator[Consumer]:
    """Run this file until the block ends."""
    options = {"name": name, "connect": connect, "rig": rig, "file": file and str(file)}
    command = [sys.executable, "-m", "tests.autoexpose_daemon.publish.consumer", json.dumps(options)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield Consumer(process)
        finally:
            process.kill()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
