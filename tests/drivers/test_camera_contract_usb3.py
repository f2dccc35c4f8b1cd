"""The contract of test_camera_contract.py over USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes import run_under_shim

pytestmark = pytest.mark.realtime


def test_the_contract_holds_over_usb3_vision(tmp_path: Path) -> None:
    run_under_shim(Path(__file__).with_name("test_camera_contract.py"), *(tmp_path / str(port) for port in range(4)))
