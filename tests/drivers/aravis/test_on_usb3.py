"""The suites that run on both transports, over USB3 Vision: in one process with fake cameras on its USB bus."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import REPOSITORY
from tests.fakes import run_under_shim
from tests.xml_cameras import COMBINATIONS, REAL

pytestmark = pytest.mark.wire

HERE = Path(__file__).parent
DIALECTS = HERE / "test_dialects_on_the_wire.py"
SUITES = [
    HERE / "test_camera_contract.py",
    DIALECTS,
    HERE / "test_shapes_on_the_wire.py",
    HERE / "test_pixel_formats_on_the_wire.py",
    REPOSITORY / "tests/autoexpose_daemon/runtime/test_daemon.py",
]
PORTS = len(COMBINATIONS)
"""As many cameras as the dialects need at a time."""


@pytest.mark.timeout(300)
@pytest.mark.parametrize("marked", ["not realtime", pytest.param("realtime", marks=pytest.mark.realtime)])
def test_usb3_vision_behaves_as_gige_does(marked: str, tmp_path: Path) -> None:
    run_under_shim(SUITES, *(tmp_path / str(port) for port in range(PORTS)), timeout_s=250, marked=marked)


@pytest.mark.data
def test_real_descriptions_over_usb3_vision(tmp_path: Path) -> None:
    run_under_shim(DIALECTS, *(tmp_path / name for name in REAL["usb3"]), marked="data")
