"""Tests your own software in CI, on fake cameras and a real daemon: pytest examples/test_with_fake_cameras.py

`camera_rig` comes with camera-twin, a plugin of pytest: two GigE Vision cameras on one trigger wire. The light jumps.
"""

import subprocess
from pathlib import Path

import pytest

from autoexpose_daemon.client import ReceivedSet, RigClient

LIGHT = {"repeat_s": 4, "light": [{"at_s": 0, "lux": 300}, {"at_s": 2, "lux": 20}]}


def is_usable(received: ReceivedSet) -> bool:
    """Your own software: here, whether a set is neither too dark nor too bright."""
    return all(30 < frame.grey8().mean() < 200 for frame in received.frames.values())


@pytest.mark.camera_twin(light=LIGHT)
def test_most_sets_are_usable_while_the_light_jumps(camera_rig, tmp_path: Path) -> None:
    """Run the daemon for some seconds, and judge what a client gets of it."""
    config = tmp_path / "rig.yaml"
    cameras = ", ".join(f"{name}: {{serial: {camera.serial}}}" for name, camera in camera_rig.items())
    config.write_text(f"cameras: {{{cameras}}}\npublish: {{rig: ci}}\n")
    with subprocess.Popen(["autoexpose", "run", "-c", str(config)]) as daemon, RigClient("ci") as client:
        try:
            usable = 0
            for _ in range(240):
                received = client.next_set(timeout_s=30)
                assert received is not None, "the daemon sends nothing"
                usable += is_usable(received)
        finally:
            daemon.terminate()
    assert usable > 0.8 * 240
