"""The daemon as a service, in real time on fake cameras: states, reloads, restarts."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.autoexpose_daemon.service_process import PATIENCE_S, ServiceProcess, running_service
from tests.autoexpose_daemon.stereo import START_CAMERA, stereo_cameras
from tests.fakes import FakeCamera, fake_camera

pytestmark = pytest.mark.realtime

RESTART_S = 10.0
"""What is promised after SIGKILL; machines are busy, so the best of a few counts."""
ATTEMPTS = 3


def write_config(file: Path, left: FakeCamera, right: FakeCamera, **sections: Any) -> Path:
    cameras = {"left": {"serial": left.serial}, "right": {"serial": right.serial}}
    file.write_text(yaml.safe_dump({"cameras": cameras, **sections}))
    return file


def wait_for_exposing(service: ServiceProcess) -> None:
    service.wait_for("STATUS=exposing")


def test_a_stopped_trigger_and_a_lost_camera_degrade_and_the_watchdog_is_fed(tmp_path: Path) -> None:
    with stereo_cameras() as (left, right, _):
        with running_service(write_config(tmp_path / "rig.yaml", left, right)) as service:
            service.wait_for("READY=1")
            assert not any(message.startswith("STATUS=degraded") for message in service.heard)
            for camera in (left, right):
                camera.inject("ignore_triggers", count=300)
            assert service.wait_for("STATUS=degraded").startswith("STATUS=degraded: no triggers")
            for _ in range(2):
                service.wait_for("WATCHDOG=1")
            wait_for_exposing(service)
            right.kill()
            service.wait_until(lambda message: "right camera gone" in message, "the right camera being gone")
            for _ in range(2):
                service.wait_for("WATCHDOG=1")
            with START_CAMERA(right.serial, side="right", line0=right.line0):
                wait_for_exposing(service)
            assert service.stop() == 0
        assert service.heard.count("READY=1") == 1


def test_a_camera_that_is_missing_at_the_start_holds_up_readiness_only_for_a_while(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    with fake_camera() as left:
        file.write_text(
            yaml.safe_dump({"cameras": {"left": {"serial": left.serial}, "right": {"serial": "NOT-THERE"}}})
        )
        with running_service(file) as service:
            service.wait_for("READY=1")
            assert any(message.startswith("STATUS=degraded: right camera gone") for message in service.heard)


def test_sighup_takes_a_policy_with_the_cameras_going_on(tmp_path: Path) -> None:
    with stereo_cameras() as (left, right, _):
        file = write_config(tmp_path / "rig.yaml", left, right)
        with running_service(file) as service:
            wait_for_exposing(service)
            start = {"exposure_time_us": 777}
            write_config(file, left, right, control={"policy": "fixed", "start": start})
            service.reload()
            service.wait_for("RELOADING=1")
            service.wait_for("READY=1")
            service.wait_until(lambda message: "777 us" in message, "the new exposure")
            assert "the cameras went on" in service.log
            assert service.log.count(", ready") == 2


def test_sighup_opens_cameras_anew_for_another_rate(tmp_path: Path) -> None:
    with stereo_cameras() as (left, right, _):
        file = write_config(tmp_path / "rig.yaml", left, right)
        with running_service(file) as service:
            wait_for_exposing(service)
            write_config(file, left, right, trigger={"rate_hz": 60.001})
            service.reload()
            service.wait_for("RELOADING=1")
            service.wait_for("READY=1")
            wait_for_exposing(service)
            assert service.log.count(", ready") == 4


@pytest.mark.parametrize(
    ("sections", "why"),
    [
        ({"exposure": {"max_time": 1}}, "exposure.max_time: unknown key"),
        ({"exposure": {"min_time_us": 1e-3, "max_time_us": 2e-3}, "control": {"policy": "neves2009"}}, "leave no"),
        ({"control": {"roi": {"left": {"rectangles": [{"box": [0, 0, 9999, 10]}]}}}}, "9999"),
        ({"trigger": {"line": "Line9"}}, "Line9"),
    ],
)
def test_a_configuration_that_cannot_be_leaves_the_old_one_at_work(
    tmp_path: Path, sections: dict[str, Any], why: str
) -> None:
    with stereo_cameras() as (left, right, _):
        file = write_config(tmp_path / "rig.yaml", left, right)
        with running_service(file) as service:
            wait_for_exposing(service)
            write_config(file, left, right, **sections)
            service.reload()
            deadline_s = time.monotonic() + PATIENCE_S
            while "is not taken" not in service.log and time.monotonic() < deadline_s:
                service.wait_for("WATCHDOG=1")
            (sentence,) = [line for line in service.log.splitlines() if "is not taken" in line]
            assert why in sentence
            wait_for_exposing(service)
            assert service.stop() == 0


def test_after_sigkill_it_exposes_again_from_where_it_was(tmp_path: Path) -> None:
    start = {"exposure_time_us": 100}
    with stereo_cameras() as (left, right, _):
        file = write_config(tmp_path / "rig.yaml", left, right, control={"policy": "neves2009", "start": start})

        def restart_s() -> float:
            """Run, kill, run again; how long the second run takes to expose."""
            with running_service(file, tmp_path) as service:
                wait_for_exposing(service)
                kept = tmp_path / "last-exposure.json"
                service.wait_until(lambda _: kept.exists(), "the last exposure")
                service.kill()
            begun_s = time.monotonic()
            with running_service(file, tmp_path) as service:
                wait_for_exposing(service)
                return time.monotonic() - begun_s

        assert any(restart_s() < RESTART_S for _ in range(ATTEMPTS))
        kept = json.loads((tmp_path / "last-exposure.json").read_text())
        assert kept["exposure_time_us"] > 100


