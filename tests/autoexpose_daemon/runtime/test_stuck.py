"""When a camera that sends nothing is reopened."""

from __future__ import annotations

from itertools import pairwise

import pytest

from autoexpose_daemon.runtime.stuck import FIRST_PAUSE_NS, LONGEST_PAUSE_NS, StuckStreams
from autoexpose_daemon.status.telemetry import GONE, Telemetry

TENTH_NS = 100_000_000


def attempts_s(
    right: str = "B 2", left_flows: bool = True, until_s: float = 100.0, period_s: float = 1 / 60
) -> list[float]:
    """When the right camera is reopened, which sent its last frame at 0."""
    stuck, telemetry = StuckStreams(period_s), Telemetry(cameras={"left": "A 1", "right": right})
    telemetry.last_frame_ns = {"left": 0, "right": 0}
    attempts = []
    for now_ns in range(0, 100_000_000_000, TENTH_NS):
        if left_flows:
            telemetry.last_frame_ns["left"] = now_ns
        for side in stuck.sides(telemetry, now_ns):
            assert side == "right"
            attempts.append(now_ns * 1e-9)
    return attempts


def test_a_silent_camera_beside_one_that_sends_is_reopened_less_and_less_often() -> None:
    attempts = attempts_s()
    assert attempts[0] == pytest.approx(FIRST_PAUSE_NS * 1e-9 + 0.5, abs=0.2)
    pauses = [later - earlier for earlier, later in pairwise(attempts)]
    assert pauses == pytest.approx([6, 12, 24, 48], abs=0.3)
    assert max(pauses) < LONGEST_PAUSE_NS * 1e-9


def test_a_stopped_trigger_or_a_lost_camera_reopens_nothing() -> None:
    assert attempts_s(left_flows=False) == []
    assert attempts_s(right=GONE) == []


def test_with_a_slow_trigger_it_waits_for_many_periods() -> None:
    assert attempts_s(period_s=2.0)[0] == pytest.approx(60, abs=1)


def test_once_it_sends_again_the_pause_is_reset() -> None:
    stuck, telemetry = StuckStreams(1 / 60), Telemetry(cameras={"left": "A 1", "right": "B 2"})
    for start_ns in (0, 10 * FIRST_PAUSE_NS):
        telemetry.last_frame_ns = {"left": start_ns, "right": start_ns}
        assert stuck.sides(telemetry, start_ns) == []
        telemetry.last_frame_ns["left"] = start_ns + 2 * FIRST_PAUSE_NS
        assert stuck.sides(telemetry, start_ns + FIRST_PAUSE_NS) == []
        assert stuck.sides(telemetry, start_ns + 2 * FIRST_PAUSE_NS) == ["right"]
