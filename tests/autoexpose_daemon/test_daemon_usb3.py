"""The daemon on two fake cameras on USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes import run_under_shim

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]


def test_the_daemon_does_over_usb3_vision_what_it_does_over_gige(tmp_path: Path) -> None:
    ports = [tmp_path / name for name in ("left", "right", "left-again")]
    run_under_shim(Path(__file__).with_name("test_daemon.py"), *ports, timeout_s=220)
