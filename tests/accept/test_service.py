"""The daemon as a service, in real time on fake cameras: states, reloads, restarts.

tests/autoexpose_daemon/service/test_service.py shows the same on cameras that do as they are told.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from calibration.document import CameraIdentity
from calibration.response.file import Origin, ResponseFile
from fake_camera.device.faults import Fault
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.service.service_process import ServiceProcess, running_service
from tests.autoexpose_daemon.stereo import stereo_cameras
from tests.fakes import FakeCamera

pytestmark = pytest.mark.realtime

IMPOSSIBLE: list[tuple[dict[str, Any], str]] = [
    ({"exposure": {"max_time": 1}}, "exposure.max_time: unknown key"),
    (
        {
            "exposure": {"min_gain_db": 90, "max_gain_db": 95},
            "control": {"start": {"exposure_time_us": 99, "gain_db": 90}},
        },
        "gain limits 90 to ",
    ),
    ({"control": {"roi": {"left": {"rectangles": [{"box": [0, 0, 9999, 10]}]}}}}, "9999"),
    ({"trigger": {"line": "Line9"}}, "Line9"),
]
"""What the file itself shows, what the cameras' limits, their frames, and what only an opened camera says."""

Rig = tuple[FakeCamera, FakeCamera]


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with stereo_cameras() as (left, right, _):
        yield left, right


@pytest.fixture
def file(tmp_path: Path, rig: Rig) -> Path:
    return configure(tmp_path / "rig.yaml", rig)


def configure(file: Path, rig: Rig, **sections: Any) -> Path:
    cameras = {name: {"serial": camera.serial} for name, camera in zip(("left", "right"), rig, strict=True)}
    file.write_text(yaml.safe_dump({"cameras": cameras, **sections}))
    return file


def wait_for_exposing(service: ServiceProcess) -> None:
    service.wait_for("STATUS=exposing")


def wait_for_signs_of_life(service: ServiceProcess) -> None:
    for _ in range(3):
        service.wait_for("WATCHDOG=1")


def wait_for_refusals(service: ServiceProcess, count: int) -> None:
    service.wait_until(lambda _: service.log.count("configuration rejected") == count, f"{count} refusals")


def test_a_stopped_trigger_and_a_lost_camera_degrade_and_feed_the_watchdog(rig: Rig, file: Path) -> None:
    with running_service(file) as service:
        service.wait_for("READY=1")
        assert not any(message.startswith("STATUS=degraded") for message in service.heard)
        for camera in rig:
            camera.inject(Fault.IGNORE_TRIGGERS, count=240)
        service.wait_for("STATUS=degraded: no triggers")
        wait_for_signs_of_life(service)
        wait_for_exposing(service)
        rig[1].inject(Fault.VANISH, count=300)
        service.wait_until(lambda message: "right camera gone" in message, "the right camera being gone")
        wait_for_signs_of_life(service)
        wait_for_exposing(service)
        assert service.stop() == 0
        service.wait_for("STOPPING=1")
        service.wait_for("STATUS=stopping")
        assert service.heard.count("READY=1") == 1


def test_sighup_takes_what_can_be_and_says_why_not(rig: Rig, file: Path) -> None:
    with running_service(file) as service:
        wait_for_exposing(service)
        for count, (sections, why) in enumerate(IMPOSSIBLE, 1):
            configure(file, rig, **sections)
            service.reload()
            wait_for_refusals(service, count)
            assert why in next(line for line in reversed(service.log.splitlines()) if "configuration rejected" in line)
            wait_for_exposing(service)
        response = file.with_name("left.response.yaml")
        ResponseFile(ResponseFunction.linear()).save(response)
        cameras = {"left": {"serial": rig[0].serial, "response": response.name}, "right": {"serial": rig[1].serial}}
        configure(file, rig, cameras=cameras)
        service.reload()
        service.wait_for("RELOADING=1")
        service.wait_for("READY=1")
        identity = CameraIdentity("Autoexpose", "FakeGV287M", rig[0].serial)
        ResponseFile(ResponseFunction.linear(), Origin(identity, PixelFormat.MONO12)).save(response)
        service.reload()
        service.wait_until(lambda _: "pixel_format is Mono12" in service.log, "a refusal of the response file")
        wait_for_exposing(service)
        ResponseFile(ResponseFunction.linear()).save(response)
        opened = service.log.count(", ready")
        configure(file, rig, cameras=cameras, control={"policy": "fixed", "start": {"exposure_time_us": 777}})
        service.reload()
        service.wait_for("RELOADING=1")
        service.wait_for("READY=1")
        service.wait_until(lambda message: "777 us" in message, "the new exposure")
        assert service.log.count(", ready") == opened
        configure(file, rig, trigger={"rate_hz": 60.001})
        service.reload()
        service.wait_for("RELOADING=1")
        service.wait_for("READY=1")
        wait_for_exposing(service)
        assert service.log.count(", ready") == opened + 2
