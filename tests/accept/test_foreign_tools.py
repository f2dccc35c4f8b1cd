"""Debian's own Aravis tools on our cameras, for longer than `make test` takes."""

from __future__ import annotations

import re
import subprocess

import pytest

from tests.fakes import fake_camera


@pytest.mark.quiet("With its default socket buffer a client that waits for a busy processor loses frames.")
def test_arv_camera_test_completes_every_buffer() -> None:
    with fake_camera() as camera:
        listed = subprocess.run(["arv-tool-0.8"], text=True, capture_output=True, timeout=30, check=True).stdout
        name = next(line.split()[0] for line in listed.splitlines() if camera.serial in line)
        command = ["arv-camera-test-0.8", "-n", name, "--duration", "5", "--no-packet-socket"]
        result = subprocess.run(command, text=True, capture_output=True, timeout=60, check=True)
    print(result.stdout)
    completed = int(re.findall(r"n_completed_buffers\s*=\s*(\d+)", result.stdout)[-1])
    failures = int(re.findall(r"n_failures\s*=\s*(\d+)", result.stdout)[-1])
    assert completed > 100
    assert failures == 0


def test_arv_tool_lists_both_cameras_and_reads_and_writes_their_nodes() -> None:
    def tool(*arguments: str) -> str:
        return subprocess.run(
            ["arv-tool-0.8", *arguments], text=True, capture_output=True, timeout=30, check=True
        ).stdout

    with fake_camera(side="left") as left, fake_camera(side="right") as right:
        listed = tool()
        for camera, exposure_us in ((left, 1234), (right, 4321)):
            assert camera.serial in listed
            tool("-a", camera.address, "control", "ExposureAuto=Off", f"ExposureTime={exposure_us}")
            assert f"ExposureTime = {exposure_us} " in tool("-a", camera.address, "control", "ExposureTime") + " "
