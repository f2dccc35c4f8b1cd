"""The daemon on two fake cameras on USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes import run_under_shim

pytestmark = pytest.mark.realtime


def test_the_daemon_does_over_usb3_vision_what_it_does_over_gige(tmp_path: Path) -> None:
    run_under_shim(Path(__file__).with_name("test_daemon.py"), tmp_path / "left", tmp_path / "right")
