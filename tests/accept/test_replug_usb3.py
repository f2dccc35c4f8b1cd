"""Cables pulled and plugged in again, over USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.accept.test_replug import CYCLES
from tests.fakes import run_under_shim

TIMEOUT_S = 100 + 20 * CYCLES

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(20 + TIMEOUT_S)]


def test_unplugged_cameras_come_back_over_usb3_vision(tmp_path: Path) -> None:
    run_under_shim(
        Path(__file__).with_name("test_replug.py"), tmp_path / "left", tmp_path / "right", timeout_s=TIMEOUT_S
    )
