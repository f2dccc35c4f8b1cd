"""When a camera that sends nothing is reopened."""

from __future__ import annotations

from itertools import pairwise

import pytest

from autoexpose_daemon.runtime.rig_health import (
    BESIDE_ANOTHER,
    FIRST_PAUSE_NS,
    LIKE_ALL,
    LONGEST_PAUSE_NS,
    StuckStreams,
)
from autoexpose_daemon.status.telemetry import GONE
from imaging.frames import Side

TENTH_NS = 100_000_000
CAMERAS: dict[Side, str] = {"left": "A 1", "right": "B 2"}


def attempts_s(
    right: str = "B 2", left_flows: bool = True, until_s: float = 100.0, period_s: float = 1 / 60
) -> list[float]:
    """When the right camera is reopened, which sent its last frame at 0."""
    stuck = StuckStreams(period_s, needs_pulses=True)
    cameras: dict[Side, str] = {"left": "A 1", "right": right}
    for side in cameras:
        stuck.arrived(side, 0)
    attempts = []
    for now_ns in range(0, 100_000_000_000, TENTH_NS):
        if left_flows:
            stuck.arrived("left", now_ns)
        for side, why in stuck.reasons(cameras, now_ns).items():
            assert (side, why) == ("right", BESIDE_ANOTHER)
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
    stuck = StuckStreams(1 / 60, needs_pulses=True)
    for start_ns in (0, 10 * FIRST_PAUSE_NS):
        for side in CAMERAS:
            stuck.arrived(side, start_ns)
        assert stuck.reasons(CAMERAS, start_ns) == {}
        stuck.arrived("left", start_ns + 2 * FIRST_PAUSE_NS)
        assert stuck.reasons(CAMERAS, start_ns + FIRST_PAUSE_NS) == {}
        assert stuck.reasons(CAMERAS, start_ns + 2 * FIRST_PAUSE_NS) == {"right": BESIDE_ANOTHER}


def test_where_no_pulses_are_needed_all_silent_cameras_are_reopened() -> None:
    stuck = StuckStreams(1 / 60, needs_pulses=False)
    for side in CAMERAS:
        stuck.arrived(side, 0)
    assert stuck.reasons(CAMERAS, FIRST_PAUSE_NS // 2) == {}
    assert stuck.reasons(CAMERAS, 2 * FIRST_PAUSE_NS) == {"left": LIKE_ALL, "right": LIKE_ALL}
    assert stuck.reasons({"left": "A 1"}, 2 * FIRST_PAUSE_NS + 1, untriggered=["left"]) == {}
