"""A network that fragments a camera's packets, which needs an interface with a small MTU: one of its own."""

from __future__ import annotations

import contextlib
import logging
import subprocess
import sys
from pathlib import Path

import pytest

from autoexpose_daemon.doctor.facts import Need, gather
from autoexpose_daemon.doctor.judge import judge_gige
from drivers.aravis import open_camera
from drivers.setup import CameraSetup, TriggerSetup
from fake_camera.device.faults import Fault
from tests.fakes import fake_camera

MTU_BYTES = 1500
NETWORK = ["unshare", "--map-root-user", "--net", "sh", "-c", f'ip link set lo mtu {MTU_BYTES} up && exec "$@"', "sh"]


def reassembled() -> int:
    """Packets that this host has put together from fragments."""
    names, values = (line.split() for line in Path("/proc/net/snmp").read_text().splitlines() if line.startswith("Ip:"))
    return int(dict(zip(names, values, strict=True))["ReasmOKs"])


def test_packets_in_fragments_are_named_in_the_log_and_by_the_doctor() -> None:
    if subprocess.run([*NETWORK, "true"], check=False, capture_output=True).returncode:
        pytest.skip("this machine allows no network namespace, or has no ip")
    command = [*NETWORK, sys.executable, "-m", __name__]
    inside = subprocess.run(command, text=True, capture_output=True, timeout=300, check=False)
    assert inside.returncode == 0, inside.stdout + inside.stderr
    assert "its packets of 1500 bytes" not in inside.stderr
    assert "its packets of 9000 bytes exceed the MTU of lo, 1500 bytes" in inside.stderr


def main() -> None:
    """What happens in that network; the log goes to stderr."""
    logging.basicConfig()
    setup = CameraSetup(TriggerSetup("free_run", rate_hz=30.0))
    with fake_camera() as fake, contextlib.closing(open_camera(fake.serial, setup)):
        assert reassembled() == 0  # the largest size that fits was found
        assert not [finding for finding in judge_gige(gather().gige, Need()) if "fragments" in finding.sentence]
    with fake_camera() as fake:
        fake.inject(Fault.FRAGMENT, count=1_000_000)
        with contextlib.closing(open_camera(fake.serial, setup)) as camera:
            camera.start()
            while camera.next_frame(1.0) is None:
                pass
            assert reassembled() > 0
            (finding,) = (it for it in judge_gige(gather().gige, Need()) if "fragments" in it.sentence)
            assert finding.check == "gige-packets"
            assert "streams packets of 9000 bytes at present" in finding.sentence


if __name__ == "__main__":
    main()
