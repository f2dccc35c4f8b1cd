"""The daemon on two fake cameras through stock Aravis; the account of triggers is checked at the end of every run."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from autoexpose_daemon.cameras import openers
from autoexpose_daemon.config import Config
from autoexpose_daemon.daemon import Daemon
from drivers.account import LossReason
from tests.autoexpose_daemon.stereo import (
    JOIN_WARNING,
    PATIENCE_S,
    START_CAMERA,
    running_daemon,
    stereo_cameras,
)

pytestmark = [pytest.mark.realtime, JOIN_WARNING]


def test_pairs_arrive_are_decided_on_and_written() -> None:
    with stereo_cameras() as cameras, running_daemon(cameras, {"control": {"policy": "neves2009"}}) as run:
        run.wait_for_pairs(120)
        tally, telemetry = run.daemon.tally, run.daemon.telemetry
        assert sum(pair.right is not None for pair, _ in run.seen[-60:]) >= 55
        assert sum(count for reason, count in tally.lost.items() if reason is not LossReason.STARTUP) <= 2
        assert telemetry.mismatched_pairs <= 2
        assert telemetry.unexplained_mismatches == 0
        skews_ns = [abs(p.left.host_time_ns - p.right.host_time_ns) for p, _ in run.seen if p.right is not None]
        assert np.median(skews_ns) < 1e9 / 60 / 10
        decided = {round(decision.setting.level, 3) for _, decision in run.seen}
        applied = {round(pair.left.setting.level, 3) for pair, _ in run.seen}
        assert len(decided & applied) > 1


def test_the_left_camera_may_trigger_the_right_one() -> None:
    trigger = {"mode": "primary", "line": "Line3", "output_line": "Line1", "rate_hz": 40}
    with (
        stereo_cameras(left_triggers_right=True) as cameras,
        running_daemon(cameras, {"control": {"policy": "neves2009"}, "trigger": trigger}) as run,
    ):
        run.wait_for_pairs(80)
        pairs = [pair for pair, _ in run.seen[-60:]]
        skews_ns = [abs(pair.left.host_time_ns - pair.right.host_time_ns) for pair in pairs if pair.right is not None]
        assert len(skews_ns) == 60
        assert np.median(skews_ns) < 1e9 / 40 / 10
        assert sum(count for reason, count in run.daemon.tally.lost.items() if reason is not LossReason.STARTUP) <= 2


def test_a_killed_camera_leaves_the_other_at_work_and_comes_back() -> None:
    with stereo_cameras() as cameras, running_daemon(cameras, {"control": {"policy": "neves2009"}}) as run:
        run.wait_for_pairs(30)
        run.left.kill()
        run.wait_until(lambda: run.seen[-1][0].right is None, "frames of the other camera alone")
        alone = len(run.seen)
        run.wait_until(lambda: len(run.seen) > alone + 60, "the other camera's frames going on")
        truth = run.truths[0].with_name("again.jsonl")
        with START_CAMERA(run.left.serial, line0=run.left.line0, options=["--truth", str(truth)]):
            run.truths.append(truth)
            run.wait_for_pairs(30)
            assert run.daemon.tally.lost[LossReason.CAMERA_GONE] > 0
            assert run.daemon.telemetry.reconnects == 1


def test_both_cameras_gone_and_back_is_counted_by_the_clock() -> None:
    with stereo_cameras() as cameras, running_daemon(cameras, {"control": {"policy": "fixed"}}) as run:
        run.wait_for_pairs(60)
        for camera in (run.left, run.right):
            camera.inject("vanish", count=60)
        run.wait_until(lambda: run.daemon.telemetry.reconnects == 2, "both cameras back")
        run.wait_for_pairs(30)
        assert run.daemon.tally.lost[LossReason.CAMERA_GONE] >= 60


def test_a_trigger_at_another_rate_is_told_at_the_start(caplog: pytest.LogCaptureFixture) -> None:
    told = "left camera: starts 60.0 frames a second where trigger.rate_hz is 50"
    with stereo_cameras() as (left, right, _):
        cameras = {"left": {"serial": left.serial}, "right": {"serial": right.serial}}
        config = Config.model_validate({"cameras": cameras, "trigger": {"rate_hz": 50}})
        daemon, stop = Daemon(config, openers(config)), threading.Event()
        thread = threading.Thread(target=daemon.run, args=(stop,))
        thread.start()
        try:
            deadline = time.monotonic() + PATIENCE_S
            while told not in caplog.text and time.monotonic() < deadline:
                threading.Event().wait(0.01)
        finally:
            stop.set()
            thread.join()
    assert told in caplog.text
