"""What the first frames reveal about the wiring."""

from __future__ import annotations

import pytest

from drivers.triggers.rate import JUDGED_FRAMES, PATIENCE_NS, StartCheck
from imaging.frames import Side

MS = 1_000_000
SIDES: tuple[Side, Side] = ("left", "right")


def check(rate_hz: float = 50.0) -> StartCheck:
    judge = StartCheck({"left": "Line0", "right": "Line0"}, rate_hz)
    for side in SIDES:
        judge.ready(side, 0)
    return judge


def feed(
    judge: StartCheck, side: Side, period_ns: int = 20 * MS, offset_ns: int = 0, frames: int = JUDGED_FRAMES
) -> None:
    for number in range(frames):
        judge.frame(side, offset_ns + number * period_ns)


def test_a_sound_rig_gives_no_findings() -> None:
    judge = check()
    feed(judge, "left")
    feed(judge, "right", offset_ns=40 * MS + 5_000)  # it started two triggers later
    assert judge.findings(10 * PATIENCE_NS) == []


def test_a_lost_frame_or_two_give_no_finding() -> None:
    judge = check()
    feed(judge, "left")
    feed(judge, "right", frames=7)
    feed(judge, "right", offset_ns=180 * MS)
    assert judge.findings(PATIENCE_NS) == []


def test_the_absence_of_pulses_is_reported_once_and_not_too_soon() -> None:
    judge = check()
    assert judge.findings(PATIENCE_NS) == []
    (finding,) = judge.findings(PATIENCE_NS + 1)
    assert "no trigger pulse on Line0 for 3 s" in finding
    assert judge.findings(2 * PATIENCE_NS) == []


def test_pulses_that_are_seconds_apart_are_waited_for() -> None:
    judge = check(rate_hz=0.2)
    assert judge.findings(5 * PATIENCE_NS) == []
    (finding,) = judge.findings(5 * PATIENCE_NS + 1)
    assert "no trigger pulse on Line0 for 15 s" in finding


def test_one_camera_without_pulses_is_named() -> None:
    judge = check()
    feed(judge, "left")
    (finding,) = judge.findings(PATIENCE_NS + 1)
    assert finding.startswith("the right camera gets no trigger pulse")


def test_a_camera_whose_frames_have_holes_gets_its_pulses() -> None:
    judge = check()
    feed(judge, "left")
    judge.frame("right", None)
    assert judge.findings(PATIENCE_NS + 1) == []


def test_where_every_frame_has_holes_there_are_pulses() -> None:
    judge = check()
    for side in SIDES:
        judge.frame(side, None)
    assert judge.findings(PATIENCE_NS + 1) == []


def test_a_camera_that_is_lost_before_its_first_frame_says_nothing_about_its_wire_until_it_has_waited_again() -> None:
    judge = check()
    feed(judge, "left")
    judge.gone("right")
    assert judge.findings(PATIENCE_NS + 1) == []
    judge.ready("right", 10 * PATIENCE_NS)
    assert judge.findings(11 * PATIENCE_NS) == []
    (finding,) = judge.findings(11 * PATIENCE_NS + 1)
    assert finding.startswith("the right camera gets no trigger pulse")


def test_a_camera_that_is_left_alone_still_misses_the_pulses() -> None:
    judge = check()
    judge.gone("right")
    assert judge.findings(PATIENCE_NS) == []
    (finding,) = judge.findings(PATIENCE_NS + 1)
    assert "no trigger pulse on Line0 for 3 s" in finding


def test_a_camera_that_comes_back_after_its_frames_is_not_waited_for() -> None:
    judge = check()
    feed(judge, "left")
    feed(judge, "right", frames=3)
    judge.gone("right")
    judge.ready("right", PATIENCE_NS)
    assert judge.findings(3 * PATIENCE_NS) == []


def test_cameras_at_another_rate_are_not_reported_as_starting_apart() -> None:
    judge = check()
    feed(judge, "left", period_ns=25 * MS)
    feed(judge, "right", period_ns=25 * MS, offset_ns=7 * MS)
    assert judge.findings(0) == []


@pytest.mark.parametrize("offset_ms", [-7, 4, 10, 13])
def test_cameras_that_start_apart_are_reported(offset_ms: int) -> None:
    judge = check()
    feed(judge, "left")
    feed(judge, "right", offset_ns=offset_ms * MS)
    (finding,) = judge.findings(0)
    assert f"{min(abs(offset_ms), 20 - abs(offset_ms)):.1f} ms apart" in finding


def test_a_camera_that_starts_a_minute_later_at_a_rate_a_little_off_is_not_reported_as_apart() -> None:
    judge = check()
    period_ns = 20 * MS + 2_000  # 100 ppm
    feed(judge, "left", period_ns, frames=3000)
    for number in range(3000, 3000 + JUDGED_FRAMES):
        for side in SIDES:
            judge.frame(side, number * period_ns)
    assert judge.findings(PATIENCE_NS) == []


def test_cameras_on_a_grid_of_milliseconds_are_judged() -> None:
    judge = check(60.0)
    for number in range(JUDGED_FRAMES):
        judge.frame("left", -(-number * 50 // 3) * MS)
        judge.frame("right", (-(-number * 50 // 3) + 5) * MS)
    (finding,) = judge.findings(0)
    assert "5.0 ms apart" in finding


def test_cameras_that_the_host_triggers_are_sent_to_no_wire() -> None:
    judge = StartCheck(dict.fromkeys(SIDES, "Software"), 50.0, by_host=True)
    for side in SIDES:
        judge.ready(side, 0)
    (finding,) = judge.findings(PATIENCE_NS + 1)
    assert finding.startswith("no frame for 3 s although the cameras are triggered")
    feed(judge, "left")
    (finding,) = judge.findings(PATIENCE_NS + 2)
    assert finding.startswith("no frame from the right camera although it is triggered")
    feed(judge, "right", offset_ns=5 * MS)
    (finding,) = judge.findings(PATIENCE_NS + 3)
    assert "5.0 ms apart" in finding and "too busy" in finding


def test_pulses_that_the_other_camera_gives_may_be_missing() -> None:
    """In the mode "primary", the left camera runs freely and has no source."""
    judge = StartCheck({"right": "Line0"}, 50.0)
    for side in SIDES:
        judge.ready(side, 0)
    feed(judge, "left")
    (finding,) = judge.findings(PATIENCE_NS + 1)
    assert "no trigger pulse on Line0 for 3 s" in finding


def test_free_running_cameras_are_not_judged() -> None:
    judge = StartCheck({}, 50.0)
    judge.ready("left", 0)
    feed(judge, "left", period_ns=40 * MS)
    assert judge.findings(2 * PATIENCE_NS) == []


def test_late_pulses_give_no_finding_before_both_cameras_could_show_them() -> None:
    judge = check()
    assert "no trigger pulse" in judge.findings(PATIENCE_NS + 1)[0]
    judge.frame("left", PATIENCE_NS)
    assert judge.findings(PATIENCE_NS + 2) == []


def test_the_difference_counts_not_when_each_began() -> None:
    judge = check()
    for side in SIDES:
        feed(judge, side, offset_ns=6 * MS)
    assert judge.findings(0) == []
