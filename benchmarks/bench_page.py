"""CPU time of the page, without a browser and with one, compared with a consumer that does nothing."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.messages.keys import rig_key
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.telemetry import Telemetry
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet

RATE_HZ = 60.0
MEASURED_S = 15.0
SETTLE_S = 3.0
ENDPOINT = "tcp/127.0.0.1:7459"
PORT = 8459
SETTING = ExposureSetting(1000.0, 6.0)
DECISION = Decision(SETTING, 10.97, "held", 0.1, 0.0, 0.0, 1.0)
CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})
PAGE = f"from autoexpose_daemon.page.serve import serve; serve('rig', ['{ENDPOINT}'], '127.0.0.1', {PORT}, None)"
CONSUMER = f"""
from autoexpose_daemon.client import StereoClient
for pair in StereoClient(connect=["{ENDPOINT}"]):
    pass
"""


def picture() -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """An image with edges and noise, 720x540."""
    rng = np.random.default_rng(0)
    blocks = cv2.resize(rng.integers(0, 256, (27, 36)).astype(np.uint8), (720, 540), interpolation=cv2.INTER_NEAREST)
    return np.clip(blocks + rng.normal(0, 3, blocks.shape), 0, 255).astype(np.uint8)


@contextlib.contextmanager
def publishing() -> Iterator[None]:
    """Pairs and a status, as from a running daemon."""
    pixels, stop = picture(), threading.Event()

    def run() -> None:
        trigger = 0
        while not stop.wait(1 / RATE_HZ):
            trigger += 1
            now_ns = time.monotonic_ns()
            frame = Frame(pixels, 8, trigger, now_ns, now_ns, now_ns, SETTING)
            publisher(ControlStep(StepInputs(FrameSet(trigger, {"left": frame, "right": frame})), DECISION))

    telemetry = Telemetry()
    config = PublishConfig(listen=(ENDPOINT,))
    with Publisher(
        config, ("left", "right"), lambda _last: {rig_key("rig", "status"): describe(telemetry, CONFIG).to_json()}
    ) as publisher:
        thread = threading.Thread(target=run)
        thread.start()
        yield
        stop.set()
        thread.join()


@contextlib.contextmanager
def process(program: str) -> Iterator[int]:
    with subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.DEVNULL) as started:
        try:
            time.sleep(SETTLE_S)
            yield started.pid
        finally:
            started.terminate()


@contextlib.contextmanager
def watching() -> Iterator[None]:
    """A browser that does not draw: asks for the next pair as soon as it has one."""
    with connect(f"ws://127.0.0.1:{PORT}/live", max_size=None, proxy=None) as socket:

        def run() -> None:
            socket.send("next")
            with contextlib.suppress(ConnectionClosed):
                for message in socket:
                    if isinstance(message, bytes):
                        socket.send("next")

        thread = threading.Thread(target=run)
        thread.start()
        time.sleep(SETTLE_S)
        yield
    thread.join()


def cpu_s(pid: int) -> float:
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def percent(pid: int) -> float:
    """CPU time of a process, in percent of one core."""
    before_s, began_s = cpu_s(pid), time.monotonic()
    time.sleep(MEASURED_S)
    return 100 * (cpu_s(pid) - before_s) / (time.monotonic() - began_s)


def main() -> None:
    with publishing():
        with process(CONSUMER) as pid:
            consumer = percent(pid)
        costs = {"a consumer that does nothing": consumer}
        with process(PAGE) as pid:
            costs["the page, nobody watching"] = percent(pid)
            with watching():
                costs["the page, one browser"] = percent(pid)
                with watching():
                    costs["the page, two browsers"] = percent(pid)
            time.sleep(SETTLE_S)
            costs["the page, nobody watching any more"] = percent(pid)
    for name, cost in costs.items():
        print(f"{name:36} {cost:6.1f} % of one core  {cost / consumer:6.2f}")


if __name__ == "__main__":
    main()
