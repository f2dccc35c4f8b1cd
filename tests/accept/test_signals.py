"""The daemon paused and killed, in real time on fake cameras; test_on_usb3.py does it over USB3 Vision."""

from __future__ import annotations

import json
import re
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.autoexpose_daemon.service.service_process import ServiceProcess, running_service
from tests.autoexpose_daemon.stereo import stereo_cameras
from tests.fakes import FakeCamera

pytestmark = pytest.mark.realtime

RESTART_S = 10.0
"""What is promised after SIGKILL; machines are busy, so the best of a few counts."""
ATTEMPTS = 3
PAUSE_S = 5.0
"""GigE Vision cameras forget their controller after 3 s."""


@pytest.fixture(scope="module")
def rig() -> Iterator[tuple[FakeCamera, FakeCamera]]:
    with stereo_cameras() as (left, right, _):
        yield left, right


@pytest.fixture
def file(tmp_path: Path, rig: tuple[FakeCamera, FakeCamera]) -> Path:
    path = tmp_path / "rig.yaml"
    cameras = {name: {"serial": camera.serial} for name, camera in zip(("left", "right"), rig, strict=True)}
    control = {"policy": "neves2009", "start": {"exposure_time_us": 100}}
    path.write_text(yaml.safe_dump({"cameras": cameras, "control": control}))
    return path


def wait_for_exposing(service: ServiceProcess) -> None:
    service.wait_for("STATUS=exposing")


def _exposing_on(message: str) -> bool:
    rate = re.match(r"STATUS=exposing; ([\d.]+) pairs/s", message)
    return rate is not None and float(rate[1]) > 0


def test_a_pause_of_5_s_heals(file: Path) -> None:
    with running_service(file) as service:
        wait_for_exposing(service)
        service.process.send_signal(signal.SIGSTOP)
        threading.Event().wait(PAUSE_S)
        service.process.send_signal(signal.SIGCONT)
        for _ in range(3):  # one a second, of which the first may have waited to be read
            service.wait_until(_exposing_on, "exposing at some rate")
        assert service.stop() == 0
        assert "Traceback" not in service.log
        assert service.heard.count("READY=1") == 1


def test_after_sigkill_it_exposes_again_from_where_it_was(file: Path, tmp_path: Path) -> None:
    kept = tmp_path / "last-exposure.json"

    def restart_s() -> float:
        """Run, kill, run again; how long the second run takes to expose."""
        with running_service(file, tmp_path) as service:
            wait_for_exposing(service)
            service.wait_until(lambda _: kept.exists(), "the last exposure")
            service.kill()
        begun_s = time.monotonic()
        with running_service(file, tmp_path) as service:
            wait_for_exposing(service)
            return time.monotonic() - begun_s

    assert any(restart_s() < RESTART_S for _ in range(ATTEMPTS))
    assert json.loads(kept.read_text())["exposure_time_us"] > 100
