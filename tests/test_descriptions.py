"""Every real description over the transport it is for; `make test-data` prints the table."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fakes import usb3_environment


@pytest.mark.data
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("transport", ["gige", "usb3"])
def test_every_real_description_is_driven_or_refused_for_what_stays(
    transport: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    environment = dict(os.environ) if transport == "gige" else usb3_environment(tmp_path / "port")
    with capfd.disabled():
        print(f"\n{transport}")
        table = subprocess.run([sys.executable, "-m", "tests.descriptions"], env=environment, check=False)
    assert table.returncode == 0
