"""`autoexpose doctor` with a camera that the kernel has attached: real permissions, real udev, what it tells to do."""

from __future__ import annotations

import grp
import json
import pwd
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.aravis import open_camera
from drivers.setup import CameraSetup, TriggerSetup
from tests.fakes import FakeCamera
from tests.kernel.usbip import camera_with_cable, output

DOCTOR = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()", "doctor", "--json"]
USER = pwd.getpwnam("nobody")
Findings = dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def fake() -> Iterator[FakeCamera]:
    with camera_with_cable(options=["--line0-rate-hz", "5"]) as (camera, cable):
        cable.plug_in()
        yield camera


def examined(**user: Any) -> tuple[bool, Findings]:
    """Whether the daemon could run, and the findings by their check; `user` as `subprocess.run` takes it."""
    process = subprocess.run(DOCTOR, capture_output=True, text=True, check=False, **user)
    assert process.stderr == ""
    findings = {finding["check"]: finding for finding in json.loads(process.stdout)["findings"]}
    return process.returncode == 0, findings


def as_user(*groups: str) -> dict[str, Any]:
    return {
        "user": USER.pw_uid,
        "group": USER.pw_gid,
        "extra_groups": [grp.getgrnam(group).gr_gid for group in groups],
    }


def follow(finding: dict[str, Any]) -> None:
    """Do what the doctor says; the tests are root already."""
    output("bash", "-c", finding["fix"].replace("sudo ", ""))
    output("udevadm", "settle")


def test_the_fixes_of_the_doctor_work(fake: FakeCamera) -> None:
    could_run, findings = examined(**as_user("video"))
    assert not could_run
    assert findings["usb-link"]["sentence"].endswith(f"{fake.serial} (Autoexpose FakeU3V287M) is linked at 5000 Mbit/s")
    assert (findings["usb-bandwidth"]["severity"], findings["usbfs-memory"]["severity"]) == ("ok", "warning")
    assert findings["usb-node"]["severity"] == "stops"
    assert findings["usb-node"]["fix"] == findings["udev-rule"]["fix"]

    follow(findings["usb-node"])
    follow(findings["usbfs-memory"])
    could_run, findings = examined(**as_user("video"))
    assert could_run
    assert {finding["severity"] for finding in findings.values()} == {"ok"}, findings
    assert "crw-rw----, group video" in findings["usb-node"]["sentence"]


def test_a_user_outside_the_group_is_told_to_join_it(fake: FakeCamera) -> None:
    could_run, findings = examined(**as_user())
    assert not could_run
    assert findings["usb-node"]["fix"].startswith("sudo usermod -aG video ")


def test_the_holder_of_a_camera_is_named(fake: FakeCamera) -> None:
    assert "usb-holder" not in examined()[1]
    camera = open_camera(fake.serial, CameraSetup(TriggerSetup("external")))
    try:
        could_run, findings = examined()
    finally:
        camera.close()
    assert not could_run
    assert "python" in findings["usb-holder"]["sentence"]
