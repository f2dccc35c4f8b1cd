"""What the first frames reveal about the wiring."""

from __future__ import annotations

import pytest

from drivers.triggers.rate import JUDGED_FRAMES, PATIENCE_NS, StartCheck
from imaging.frames import SIDES, Side

MS = 1_000_000


def check(rate_hz: float = 50.0) -> StartCheck:
    judge = StartCheck(dict.fromkeys(SIDES, "Line0"), rate_hz)
    for side in SIDES:
        judge.ready(side, 0)
    return judge


def feed(
    judge: StartCheck, side: Side, period_ns: int = 20 * MS, offset_ns: int = 0, frames: int = JUDGED_FRAMES
) -> None:
    for number in range(frames):
        judge.frame(side, offset_ns + number * period_ns)


def the_finding(judge: StartCheck, now_ns: int, *words: str) -> None:
    """It has just one finding, which contains these words."""
    (finding,) = judge.findings(now_ns)
    for each in words:
        assert each in finding


@pytest.mark.parametrize(
    "right",
    [
        [(20 * MS, 40 * MS + 5_000, JUDGED_FRAMES)],  # it started two triggers later
        [(20 * MS, 0, 7), (20 * MS, 180 * MS, JUDGED_FRAMES)],  # two frames were lost
    ],
)
def test_a_sound_rig_gives_no_findings(right: list[tuple[int, int, int]]) -> None:
    judge = check()
    feed(judge, "left")
    for period_ns, offset_ns, frames in right:
        feed(judge, "right", period_ns, offset_ns, frames)
    assert judge.findings(10 * PATIENCE_NS) == []


@pytest.mark.parametrize(
    ("rate_hz", "patience_ns", "waited"), [(50.0, PATIENCE_NS, "3 s"), (0.2, 5 * PATIENCE_NS, "15 s")]
)
def test_the_absence_of_pulses_is_reported_once_and_not_too_soon(rate_hz: float, patience_ns: int, waited: str) -> None:
    judge = check(rate_hz)
    assert judge.findings(patience_ns) == []
    the_finding(judge, patience_ns + 1, "no trigger pulse on Line0", waited)
    assert judge.findings(2 * patience_ns) == []


def test_one_camera_without_pulses_is_named_unless_its_frames_have_holes() -> None:
    judge = check()
    feed(judge, "left")
    the_finding(judge, PATIENCE_NS + 1, "the right camera gets no trigger pulse")
    for sides in (("right",), SIDES):
        judge = check()
        if "left" not in sides:
            feed(judge, "left")
        for side in sides:
            judge.frame(side, None)
        assert judge.findings(PATIENCE_NS + 1) == []


def test_a_camera_that_is_lost_before_its_first_frame_says_nothing_about_its_wire_until_it_has_waited_again() -> None:
    judge = check()
    feed(judge, "left")
    judge.gone("right")
    assert judge.findings(PATIENCE_NS + 1) == []
    judge.ready("right", 10 * PATIENCE_NS)
    assert judge.findings(11 * PATIENCE_NS) == []
    the_finding(judge, 11 * PATIENCE_NS + 1, "the right camera gets no trigger pulse")
    judge = check()
    judge.gone("right")
    the_finding(judge, PATIENCE_NS + 1, "no trigger pulse on Line0")
    judge = check()
    feed(judge, "left")
    feed(judge, "right", frames=3)
    judge.gone("right")
    judge.ready("right", PATIENCE_NS)  # it has had pulses before
    assert judge.findings(3 * PATIENCE_NS) == []


@pytest.mark.parametrize("offset_ms", [-7, 4, 10, 13])
def test_cameras_that_start_apart_are_reported(offset_ms: int) -> None:
    judge = check()
    feed(judge, "left")
    feed(judge, "right", offset_ns=offset_ms * MS)
    the_finding(judge, 0, f"{min(abs(offset_ms), 20 - abs(offset_ms)):.1f} ms apart")


def test_cameras_at_another_rate_or_in_step_are_not_apart() -> None:
    judge = check()
    feed(judge, "left", 25 * MS)
    feed(judge, "right", 25 * MS, 7 * MS)
    assert judge.findings(0) == []
    judge = check()
    for side in SIDES:  # the difference counts, not when each began
        feed(judge, side, offset_ns=6 * MS)
    assert judge.findings(0) == []
    judge, period_ns = check(), 20 * MS + 2_000  # 100 ppm, and one begins a minute later
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
    the_finding(judge, 0, "5.0 ms apart")


def test_cameras_that_the_host_triggers_are_sent_to_no_wire() -> None:
    judge = StartCheck(dict.fromkeys(SIDES, "Software"), 50.0, by_host=True)
    for side in SIDES:
        judge.ready(side, 0)
    the_finding(judge, PATIENCE_NS + 1, "no frame for 3 s", "network")
    feed(judge, "left")
    the_finding(judge, PATIENCE_NS + 2, "no frame from the right camera", "cable")
    feed(judge, "right", offset_ns=5 * MS)
    the_finding(judge, PATIENCE_NS + 3, "5.0 ms apart", "too busy")


def test_cameras_that_run_freely_have_no_pulses_to_miss() -> None:
    """In the mode "primary" that is the left one."""
    judge = StartCheck({"right": "Line0"}, 50.0)
    for side in SIDES:
        judge.ready(side, 0)
    feed(judge, "left", 40 * MS)
    the_finding(judge, PATIENCE_NS + 1, "no trigger pulse on Line0")


def test_late_pulses_give_no_finding_before_both_cameras_could_show_them() -> None:
    judge = check()
    the_finding(judge, PATIENCE_NS + 1, "no trigger pulse")
    judge.frame("left", PATIENCE_NS)
    assert judge.findings(PATIENCE_NS + 2) == []
