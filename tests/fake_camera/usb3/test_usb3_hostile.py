"""Cameras that stop and servers that lie, in a process under the shim; most of its time is spent waiting."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes import run_under_shim

SUITE = Path(__file__).parent / "hostile_suite.py"


@pytest.mark.wire
def test_hostile_cameras_under_the_shim(tmp_path: Path) -> None:
    run_under_shim(SUITE, tmp_path / "left", tmp_path / "right")
