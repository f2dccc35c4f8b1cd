"""Cameras killed and unplugged under a daemon, through stock Aravis; the account of triggers is held at the end."""

from __future__ import annotations

import pytest

from drivers.triggers.outcomes import LossReason
from fake_camera.device.faults import Fault
from tests.autoexpose_daemon.stereo import (
    JOIN_WARNING,
    START_CAMERA,
    running_daemon,
    stereo_cameras,
)

pytestmark = [pytest.mark.realtime, JOIN_WARNING]


def test_a_killed_camera_leaves_the_other_at_work_and_comes_back() -> None:
    with stereo_cameras() as cameras, running_daemon(cameras, {"control": {"policy": "neves2009"}}) as run:
        run.wait_for_pairs(30)
        run.left.kill()
        run.wait_until(lambda: len(run.seen[-1][0].frames) < 2, "frames of the other camera alone")
        alone = len(run.seen)
        run.wait_until(lambda: len(run.seen) > alone + 60, "the other camera's frames going on")
        truth = run.truths[0].with_name("again.jsonl")
        with START_CAMERA(run.left.serial, line0=run.left.line0, options=["--truth", str(truth)]):
            run.truths.append(truth)
            run.wait_for_pairs(30)
            assert run.daemon.tally.lost[LossReason.CAMERA_GONE] > 0
            assert run.daemon.telemetry.counts.reconnects == 1


def test_both_cameras_gone_and_back_is_counted_by_the_clock() -> None:
    with stereo_cameras() as cameras, running_daemon(cameras, {"control": {"policy": "fixed"}}) as run:
        run.wait_for_pairs(60)
        for camera in (run.left, run.right):
            camera.inject(Fault.VANISH, count=60)
        run.wait_until(lambda: run.daemon.telemetry.counts.reconnects == 2, "both cameras back")
        run.wait_for_pairs(30)
        assert run.daemon.tally.lost[LossReason.CAMERA_GONE] >= 60
