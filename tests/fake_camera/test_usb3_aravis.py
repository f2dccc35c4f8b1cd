"""Stock libusb and stock Aravis meet the USB3 Vision fake, in processes under the shim."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fakes import usb3_environment

pytestmark = pytest.mark.realtime

pytest.importorskip("gi", reason="PyGObject is not installed")
SUITE = Path(__file__).parent / "shim_suite.py"


def test_aravis_under_the_shim(tmp_path: Path) -> None:
    inner = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(SUITE)],
        env=usb3_environment(tmp_path / "left", tmp_path / "right"),
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert inner.returncode == 0, inner.stdout + inner.stderr
