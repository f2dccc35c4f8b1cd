"""A minute of demo at 60 Hz for each policy that promises something."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SECONDS = 60


def demo(tmp_path: Path, policy: str, transport: str = "gige") -> dict[str, Any]:
    summary = tmp_path / "summary.json"
    command = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()", "demo"]
    command += ["--seconds", str(SECONDS), "--policy", policy, "--transport", transport, "--summary", str(summary)]
    result = subprocess.run(command, text=True, capture_output=True, timeout=10 * SECONDS, check=False)
    print(result.stdout, result.stderr)
    assert result.returncode == 0
    figures: dict[str, Any] = json.loads(summary.read_text())
    return figures


@pytest.mark.parametrize(
    ("policy", "transport"),
    [("neves2009", "gige"), ("begin2022", "gige"), ("fixed", "gige"), ("metric-map", "gige"), ("metric-map", "usb3")],
)
def test_a_minute_of_demo(tmp_path: Path, policy: str, transport: str) -> None:
    figures = demo(tmp_path, policy, transport)
    assert figures["transport"] == transport
    lost = {reason: n for reason, n in figures["lost"].items() if reason not in ("startup", "shutdown")}
    assert figures["triggers"] == figures["pairs"] + sum(figures["lost"].values())
    assert sum(lost.values()) <= figures["triggers"] / 1000
    assert figures["mismatched_pairs"] <= figures["triggers"] / 1000
    assert figures["unexplained_mismatches"] == 0
    settled = [step["frames_to_settle"] is not None for step in figures["steps"]]
    assert len(settled) >= 10
    if policy in ("neves2009", "metric-map"):
        assert all(settled)
    if policy == "fixed":
        assert not all(settled)
    if figures["reference_step_ms"] <= 3.0:
        assert figures["daemon_cpu_percent"] <= 40
