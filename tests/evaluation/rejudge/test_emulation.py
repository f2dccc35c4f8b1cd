"""Frames that are exposed again against frames that were really taken."""

from __future__ import annotations

import pytest

from evaluation.experiments.rejudge.rehearsal import OFFSETS, measure_still


def test_frames_of_a_still_scene_are_as_if_really_taken() -> None:
    """Four stops either side of the bracket's middle; the brightest shot is three stops above it."""
    rows = measure_still(scene="leaves", seed=311, frames=28)
    assert [row["offset"] for row in rows] == list(OFFSETS)
    for row in rows:
        assert row["rms"] < 1.0  # grey levels, beyond noise
        assert abs(row["bias"]) < 0.2
        assert row["made_noise"] == pytest.approx(row["noise"], rel=0.25)
