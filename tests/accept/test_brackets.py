"""A drive of the demo recorded in brackets, and rejudged, as docs/do/which-policy.md says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from tests.accept.commands import output
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE


def autoexpose(*arguments: object) -> str:
    return output(*AUTOEXPOSE, *arguments, timeout_s=500)


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
