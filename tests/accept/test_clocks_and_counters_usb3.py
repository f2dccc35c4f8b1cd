"""Counters and clocks that lie, over USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes import run_under_shim

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(320)]


def test_lies_over_usb3_vision_are_as_those_over_gige(tmp_path: Path) -> None:
    ports = [tmp_path / name for name in ("left", "right")]
    run_under_shim(Path(__file__).with_name("test_clocks_and_counters.py"), *ports, timeout_s=300)
