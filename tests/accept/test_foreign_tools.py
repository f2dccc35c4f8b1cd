"""Debian's own Aravis tool on our cameras, for longer than `make test` takes."""

from __future__ import annotations

import re

import pytest

from tests.accept.commands import output
from tests.fakes import fake_camera


@pytest.mark.quiet("With its default socket buffer a client that waits for a busy processor loses frames.")
def test_arv_camera_test_completes_every_buffer() -> None:
    with fake_camera() as camera:
        listed = output("arv-tool-0.8", timeout_s=30)
        name = next(line.split()[0] for line in listed.splitlines() if camera.serial in line)
        said = output("arv-camera-test-0.8", "-n", name, "--duration", 5, "--no-packet-socket", timeout_s=60)
    print(said)
    completed, failures = (
        int(re.findall(rf"{n}\s*=\s*(\d+)", said)[-1]) for n in ("n_completed_buffers", "n_failures")
    )
    assert completed > 100 and failures == 0
