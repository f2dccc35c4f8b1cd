"""Faults, lies, pulled cables and signals again, over USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.accept.test_replug import CYCLES
from tests.fakes import run_under_shim

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(320 + 20 * CYCLES)]


@pytest.mark.parametrize(
    ("name", "timeout_s", "ports"),
    [
        ("faults", 300, 3),
        ("clocks_and_counters", 300, 3),
        ("replug", 100 + 20 * CYCLES, 3),
        ("signals", 120, 3),
        ("six_cameras", 120, 6),
    ],
)
def test_it_is_as_over_gige_vision(name: str, timeout_s: int, ports: int, tmp_path: Path) -> None:
    sockets = [tmp_path / f"camera{number}" for number in range(ports)]
    run_under_shim(Path(__file__).with_name(f"test_{name}.py"), *sockets, timeout_s=timeout_s)
