"""The daemon on two fake cameras through stock Aravis; at the end the account of triggers is compared with the wire."""

from __future__ import annotations

import numpy as np
import pytest

from tests.autoexpose_daemon.stereo import JOIN_WARNING, Run, running_daemon, stereo_cameras

pytestmark = [pytest.mark.realtime, JOIN_WARNING]

CONTROL = {"policy": "neves2009"}


def median_skew_periods(run: Run, rate_hz: float) -> float:
    """How far apart the frames of a pair started, by the cameras' clocks."""
    starts_ns = [[frame.host_time_ns for frame in pair.frames.values()] for pair, _ in run.seen]
    skews_ns = [abs(left - right) for left, right in (pair for pair in starts_ns if len(pair) == 2)]
    return float(np.median(skews_ns)) * 1e-9 * rate_hz


def test_pairs_arrive_are_decided_on_and_written() -> None:
    with stereo_cameras("--still") as cameras, running_daemon(cameras, {"control": CONTROL}) as run:
        run.wait_for_pairs(60)

        def applied() -> int:
            decided = {round(decision.setting.level, 3) for _, decision in run.seen}
            return len(decided & {round(pair.reference.setting.level, 3) for pair, _ in run.seen})

        run.wait_until(lambda: applied() > 1, "decisions that frames show")
        assert median_skew_periods(run, 60) < 0.1


@pytest.mark.gige_only  # the right camera's trigger input is independent of the transport
def test_the_left_camera_may_trigger_the_right_one() -> None:
    trigger = {"mode": "primary", "line": "Line3", "output_line": "Line1", "rate_hz": 40}
    with (
        stereo_cameras("--still", left_triggers_right=True) as cameras,
        running_daemon(cameras, {"control": CONTROL, "trigger": trigger}) as run,
    ):
        run.wait_for_pairs(40)
        assert median_skew_periods(run, 40) < 0.1
