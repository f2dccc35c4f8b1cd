"""The daemon paused and killed, over USB3 Vision."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.accept import test_signals
from tests.fakes import run_under_shim

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(140)]


def test_it_goes_on_over_usb3_vision(tmp_path: Path) -> None:
    ports = [tmp_path / name for name in ("left", "right")]
    run_under_shim(Path(test_signals.__file__), *ports, timeout_s=120)
