"""The daemon on two fake cameras on USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes import run_under_shim

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]


def test_the_daemon_does_over_usb3_vision_what_it_does_over_gige(tmp_path: Path) -> None:
    ports = [tmp_path / name for name in ("left", "right", "left-again")]
    # Cameras that are lost, and other rates: test_replug_usb3.py, test_faults_usb3.py.
    suite = Path(__file__).with_name("test_daemon.py")
    run_under_shim(suite, *ports, timeout_s=220, only="pairs_arrive or may_trigger")
