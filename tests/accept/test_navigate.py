"""The demo that teaches a lap and repeats it, in real time."""

from __future__ import annotations

from pathlib import Path

import pytest

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from tests.accept.test_demo import FULL, demo

pytestmark = pytest.mark.quiet(FULL)


def test_a_robot_repeats_its_lap_in_every_light(tmp_path: Path) -> None:
    figures = demo(tmp_path, 120, "--navigate", "--plot", str(tmp_path / "laps.png"))
    laps = figures["laps"]
    assert {lap["policy"] for lap in laps} == {DEFAULT_POLICY, "fixed"}
    assert len({lap["light"] for lap in laps}) >= 3
    ours = [lap for lap in laps if lap["policy"] == DEFAULT_POLICY]
    assert all(lap["completed"] and lap["registered_share"] > 0.8 for lap in ours)
    assert all(lap["max_error_m"] < 0.3 and lap["end_error_m"] < 0.1 for lap in ours)  # began 0.15 m aside
    assert set(figures["policies"]) == {DEFAULT_POLICY, "fixed"}
    assert (tmp_path / "laps.png").stat().st_size > 10_000
