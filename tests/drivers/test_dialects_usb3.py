"""The dialects of test_dialects_on_the_wire.py over USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes import run_under_shim
from tests.xml_cameras import COMBINATIONS, REAL

pytestmark = pytest.mark.realtime


SUITE = Path(__file__).with_name("test_dialects_on_the_wire.py")


def test_the_dialects_over_usb3_vision(tmp_path: Path) -> None:
    run_under_shim(SUITE, *(tmp_path / str(port) for port in range(len(COMBINATIONS))))


@pytest.mark.data
def test_real_descriptions_over_usb3_vision(tmp_path: Path) -> None:
    run_under_shim(SUITE, *(tmp_path / name for name in REAL["usb3"]), marked="data")
