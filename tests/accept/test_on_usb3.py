"""Faults, lies, pulled cables and signals again, over USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.accept.test_replug import CYCLES
from tests.fakes import run_under_shim

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(320 + 20 * CYCLES)]


@pytest.mark.parametrize(
    ("name", "timeout_s"),
    [("faults", 300), ("clocks_and_counters", 300), ("replug", 100 + 20 * CYCLES), ("signals", 120)],
)
def test_it_is_as_over_gige_vision(name: str, timeout_s: int, tmp_path: Path) -> None:
    ports = [tmp_path / port for port in ("left", "right", "another")]
    run_under_shim(Path(__file__).with_name(f"test_{name}.py"), *ports, timeout_s=timeout_s)
