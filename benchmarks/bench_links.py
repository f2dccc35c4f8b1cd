"""What a consumer on the same machine costs over TCP, over a Unix socket and with shared memory: 720x540 twice, 60 Hz.

Each way is measured several times by turns, so that a busy machine disturbs all alike: processor time of the sending
and of the receiving process, relative to TCP, and the time from a pair's making to its arrival.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.publish.publisher import Publisher
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet

RATE_HZ = 60.0
PAIRS = 600
ROUNDS = 5
TCP = "tcp/127.0.0.1:7449"
SETTING = ExposureSetting(1000.0, 0.0)
DECISION = Decision(SETTING, 9.97, "held", 0.1, 0.0, 0.0, 1.0)
PIXELS = np.random.default_rng(0).integers(0, 256, (540, 720)).astype(np.uint8)


class Cost(NamedTuple):
    """Processor time for a pair in both processes, how long a pair takes to arrive, and how many did not."""

    sending_ms: float
    receiving_ms: float
    median_ms: float
    p99_ms: float
    missed: float


def consume(file: str) -> None:
    """Receive until the end of the input; say what it cost from the first pair on."""
    began_s, latencies_ms = 0.0, list[float]()
    with StereoClient(zenoh_file=Path(file)) as client:
        for pair in client:
            if not latencies_ms:
                print("ready", flush=True)
                began_s = time.process_time()
            latencies_ms.append((pair.received_ns - pair.left.arrival_time_ns) * 1e-6)
            if len(latencies_ms) == PAIRS:
                break
        cpu_s, missed = time.process_time() - began_s, client.tally.missed
    percentiles = np.percentile(latencies_ms, [50, 99]).tolist()
    print(json.dumps({"cpu_s": cpu_s, "latency_ms": percentiles, "missed": missed}))


def measure(endpoint: str, shared: bool, folder: Path) -> Cost:
    """A publisher in this process, and a consumer in another one, which takes `PAIRS` of its pairs."""
    file = folder / "consumer.json5"
    memory = {"shared_memory": {"enabled": shared}}
    file.write_text(json.dumps({"connect": {"endpoints": [endpoint]}, "transport": memory}))
    with (
        Publisher(PublishConfig(listen=(endpoint,)), ("left", "right"), lambda _last: {}) as publisher,
        subprocess.Popen([sys.executable, __file__, str(file)], stdout=subprocess.PIPE, text=True) as consumer,
    ):
        assert consumer.stdout is not None
        lines: list[str] = []
        reader = threading.Thread(target=lines.extend, args=(consumer.stdout,))
        reader.start()
        before_s, counted = 0.0, 0
        next_s = time.monotonic()
        for number in itertools.count(1):
            now_ns = time.monotonic_ns()
            frame = Frame(PIXELS, 8, number, now_ns, now_ns, now_ns, SETTING)
            publisher(ControlStep(StepInputs(FrameSet(number, {"left": frame, "right": frame})), DECISION))
            if lines and not counted:
                before_s, counted = time.process_time(), number
            if len(lines) > 1:
                break
            next_s += 1.0 / RATE_HZ
            time.sleep(max(next_s - time.monotonic(), 0.0))
        sending_ms = 1e3 * (time.process_time() - before_s) / (number - counted)
        reader.join()
    got = json.loads(lines[-1])
    return Cost(sending_ms, 1e3 * got["cpu_s"] / PAIRS, *got["latency_ms"], got["missed"])


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = f"unixsock-stream/{folder}/rig.sock"
        ways = {
            "TCP": (TCP, False), "socket": (path, False),
            "TCP, shared memory": (TCP, True), "socket, shared memory": (path, True),
        }  # fmt: skip
        costs: dict[str, list[Cost]] = {way: [] for way in ways}
        for _ in range(ROUNDS):
            for way, (endpoint, shared) in ways.items():
                costs[way].append(measure(endpoint, shared, folder))
    medians = {way: Cost(*np.median(each, axis=0).tolist()) for way, each in costs.items()}
    of_tcp = medians["TCP"]
    for way, cost in medians.items():
        print(
            f"{way:22} sending {cost.sending_ms:5.2f} ms a pair ({cost.sending_ms / of_tcp.sending_ms:4.2f} of TCP), "
            f"receiving {cost.receiving_ms:5.2f} ms ({cost.receiving_ms / of_tcp.receiving_ms:4.2f}), arrival after "
            f"{cost.median_ms:.2f} ms ({cost.median_ms / of_tcp.median_ms:4.2f}), p99 {cost.p99_ms:.1f} ms, "
            f"{sum(each.missed for each in costs[way]):.0f} of {ROUNDS * PAIRS} missed"
        )


if __name__ == "__main__":
    consume(sys.argv[1]) if len(sys.argv) > 1 else main()
