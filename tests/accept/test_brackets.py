"""A drive of the demo recorded in brackets, and rejudged, as docs/which-policy.md says."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY

AUTOEXPOSE = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()"]


def autoexpose(*arguments: object) -> str:
    command = [*AUTOEXPOSE, *(str(argument) for argument in arguments)]
    result = subprocess.run(command, text=True, capture_output=True, timeout=500, check=False)
    print(result.stdout, result.stderr)
    assert result.returncode == 0
    return result.stdout


@pytest.mark.parametrize("transport", ["gige", "usb3"])
def test_a_drive_of_the_demo_is_recorded_and_judged(tmp_path: Path, transport: str) -> None:
    drive, summary, figures = tmp_path / "drive.mcap", tmp_path / "summary.json", tmp_path / "figures.json"
    autoexpose("demo", "--bracket", drive, "--seconds", 10, "--summary", summary, "--transport", transport)
    shown = json.loads(summary.read_text())
    assert shown["triggers"] == shown["pairs"] + sum(shown["lost"].values())
    autoexpose("replay", drive)
    said = autoexpose("rejudge", drive, "--policies", f"fixed,{DEFAULT_POLICY}", "--json", figures)
    judged = json.loads(figures.read_text())
    assert [one["policy"] for one in judged["policies"]] == ["fixed", DEFAULT_POLICY]
    fixed, default = judged["policies"]
    assert default["metric"] > fixed["metric"]
    assert default["matches"] > 30
    assert default["rpe_mm"] is not None
    assert judged["section"] in said
