"""One trial of `bench_sizes.py`, in a process of its own: two fake cameras at one rate, and what was lost.

Run with `.venv/bin/python benchmarks/sizes_trial.py alone|daemon gige|usb3 WxH PIXEL_FORMAT RATE_HZ SECONDS`; prints
one line of JSON. Over USB3 it needs the fake cameras on its bus: `python -m fake_camera.usb3 SOCKET SOCKET -- ...`.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.demo.fakes import FakeCameras, cameras_on_bus, fake_cameras
from autoexpose_daemon.demo.options import DemoOptions, Transport
from autoexpose_daemon.demo.show import configuration
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import openers
from drivers.aravis import find_cameras
from drivers.camera import Camera, IncompleteFrame
from drivers.triggers.outcomes import LossReason
from imaging.exposure import ExposureSetting

SETTLE_S = 1.0
"""Before what is lost counts: cameras start one after the other, and a program's first calls are slow."""

LIGHT = "light: [{at_s: 0, lux: 150}]\n"
WAIT_S = 20.0
"""For the first pair."""
BRIEF = ExposureSetting(500.0, 20.0)
"""Shorter than the time between triggers, as what the daemon decides on; cameras start with 5 ms."""
ROOM = Path(tempfile.gettempdir()) / f"autoexpose-bench-{os.getuid()}"


class Alone:
    """A receiver that takes frames from the driver, reads nothing of them and decides nothing."""

    def __init__(self, config: Config) -> None:
        self._cameras = [opener() for opener in openers(config).values()]
        for camera in self._cameras:
            camera.write(BRIEF)
        self._stop = threading.Event()
        self._received: Counter[int] = Counter()
        self._incomplete: Counter[int] = Counter()
        self._newest: Counter[int] = Counter()
        self._threads = [threading.Thread(target=self._take, args=each) for each in enumerate(self._cameras)]

    @contextmanager
    def running(self) -> Iterator[None]:
        """Take frames meanwhile."""
        for camera, thread in zip(self._cameras, self._threads, strict=True):
            camera.start()
            thread.start()
        try:
            yield
        finally:
            self._stop.set()
            for camera, thread in zip(self._cameras, self._threads, strict=True):
                thread.join()
                camera.close()

    def counts(self) -> tuple[int, int]:
        """Frame pairs sent so far, and frames of them that were lost."""
        sent = sum(self._newest.values())
        return sent // 2, sent - sum(self._received.values())

    @property
    def started(self) -> bool:
        """Whether both cameras have sent a frame."""
        return len(self._newest) == len(self._cameras)

    def _take(self, place: int, camera: Camera) -> None:
        while not self._stop.is_set():
            frame = camera.next_frame(0.05)
            if frame is None:
                continue
            self._newest[place] = frame.frame_id
            self._received[place] += not isinstance(frame, IncompleteFrame)


class WithControl:
    """The daemon."""

    def __init__(self, config: Config) -> None:
        self.daemon = Daemon(config, openers(config))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.daemon.run, args=(self._stop,))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run it meanwhile."""
        self._thread.start()
        try:
            yield
        finally:
            self._stop.set()
            self._thread.join()

    def counts(self) -> tuple[int, int]:
        """Triggers so far, and those of them that made no pair, for whatever reason."""
        tally = self.daemon.tally
        own = (LossReason.STARTUP, LossReason.SHUTDOWN)
        lost = sum(count for reason, count in tally.lost.items() if reason not in own)
        return tally.pairs + lost, lost

    @property
    def started(self) -> bool:
        """Whether there has been a pair."""
        return self.daemon.tally.pairs > 0


def measure(receiver: Alone | WithControl, cameras: FakeCameras, seconds: float) -> dict[str, float]:
    """Run a receiver for some seconds, then end the cameras."""
    with receiver.running():
        deadline_s = time.monotonic() + WAIT_S
        while not receiver.started and time.monotonic() < deadline_s:
            time.sleep(0.02)
        time.sleep(SETTLE_S)
        (sent, lost), cpu_s, began_s = receiver.counts(), time.process_time(), time.monotonic()
        time.sleep(seconds)
        (all_sent, all_lost), spent_s, took_s = (
            receiver.counts(),
            time.process_time() - cpu_s,
            time.monotonic() - began_s,
        )
    cameras.end()
    pairs = all_sent - sent
    result = {
        "pairs_per_s": pairs / took_s,
        "lost": all_lost - lost,
        "receiver_ms": 1e3 * spent_s / max(pairs, 1),
        "cameras_late": sum(camera.overruns for camera in cameras.all),
        "cameras_ms": 1e3 * sum(camera.cpu_s for camera in cameras.all) / max(all_sent, 1),
    }
    if isinstance(receiver, WithControl):
        telemetry, tally = receiver.daemon.telemetry, receiver.daemon.tally
        result["decided"] = 1 - telemetry.counts.pairs_without_decision / max(tally.pairs, 1)
        result["decision_ms"] = telemetry.decision_ms.percentiles()["p50"] or 0.0
    return result


def main() -> None:
    who, transport, size, pixel_format, rate_hz, seconds = sys.argv[1:]
    options = DemoOptions(
        60.0, DEFAULT_POLICY, None, None, "room", None, 0, cast(Transport, transport), None, True, False, None,
        pixel_format=pixel_format, size=size,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        light = Path(folder, "light.yaml")
        light.write_text(LIGHT)
        arguments = ["--line0", f"sizes-{os.getpid()}", "--still", "--light", str(light), "--keep-room", str(ROOM)]
        arguments += ["--pixel-format", pixel_format, "--size", size]
        with fake_cameras(Path(folder), arguments, cameras_on_bus(), threading.Event()) as cameras:
            cameras.wait_until_found()
            find_cameras()
            cameras.frame_s()
            cameras.run_at(float(rate_hz))
            config = configuration(options, float(rate_hz))
            print(
                json.dumps(measure(Alone(config) if who == "alone" else WithControl(config), cameras, float(seconds)))
            )


if __name__ == "__main__":
    main()
