"""The daemon on four fake cameras in two groups, a pair in the shade and one in the sun, through stock Aravis."""

from __future__ import annotations

import pytest

from fake_camera.places import SUN_STOPS
from imaging.frames import Frame
from tests.autoexpose_daemon.stereo import Run, rig_cameras, running

pytestmark = [pytest.mark.realtime, pytest.mark.gige_only]

RATE_HZ = 10.0  # a slow machine bears it
LIGHT = {"light": [{"at_s": 0, "lux": 30}]}
VIEWS_STOPS = 1.0
"""By how much views of one room may differ in the light that they send back."""


def well_exposed(frame: Frame) -> bool:
    return 60 < frame.sparse_grey8().mean() < 190


def each_by_its_own_light(run: Run) -> bool:
    if not run.seen or len(frames := run.seen[-1][0].frames) < 4:
        return False
    shade, sun = (
        {frame.setting.level for name, frame in frames.items() if name.startswith(group)} for group in ("front", "rear")
    )
    alike = len(shade) == len(sun) == 1
    return alike and all(map(well_exposed, frames.values())) and abs(max(shade) - max(sun) - SUN_STOPS) < VIEWS_STOPS


def test_each_pair_is_well_exposed_by_its_own_light_and_every_trigger_is_accounted_for() -> None:
    with rig_cameras(4, "--still", "--line0-rate-hz", f"{RATE_HZ:g}", light=LIGHT) as cameras:
        named = {name: {"serial": cameras[name].serial, "group": name.partition("_")[0]} for name in cameras}
        settings = {"cameras": named, "trigger": {"rate_hz": RATE_HZ}, "exposure": {"max_time_us": 50_000}}
        with running(cameras, [camera.truth_file for camera in cameras.values()], settings) as run:
            run.wait_until(lambda: each_by_its_own_light(run), "pairs that are exposed by their own light")
            run.wait_for_pairs(5)
            assert each_by_its_own_light(run)
            assert list(run.daemon.telemetry.groups) == ["front", "rear"]
        tally = run.daemon.tally
    assert tally.pairs >= 5
    assert {name: tally.frames[name] + tally.frames_lost[name] for name in cameras} == dict.fromkeys(
        cameras, tally.triggers
    )
