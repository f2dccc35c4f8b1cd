"""Whether frames start at the trigger rate, and what the first ones reveal about the wiring."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate, cycle, islice, pairwise

import numpy as np
import pytest

from drivers.triggers.rate import (
    HOST_RATE_TOLERANCE,
    JUDGED_FRAMES,
    PATIENCE_NS,
    RateWatch,
    StartCheck,
    TriggerGrid,
    mean_period_ns,
    wrong_rate,
)
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame
from imaging.geometry import SIDES

MS = 1_000_000
PERIOD_NS = 20 * MS
TWO_WINDOWS = 2 * JUDGED_FRAMES + 1


def frame(frame_id: int, time_ns: int) -> Frame:
    return Frame(np.zeros((2, 2), np.uint8), 8, frame_id, time_ns, time_ns, time_ns, ExposureSetting(1000.0, 0.0))


def feed(watch: RateWatch, period_ns: int = PERIOD_NS, first: int = 0, count: int = TWO_WINDOWS) -> str | None:
    trouble = None
    for number in range(first, first + count):
        trouble = watch.frame("left", frame(number, number * period_ns))
    return trouble


@pytest.mark.parametrize(
    ("period_ns", "rate", "hint"),
    [
        (40 * MS, "25.0", "fit into one period"),
        (10 * MS, "100.0", "configure"),
    ],
)
def test_a_wrong_rate_is_reported_with_its_likely_cause(period_ns: int, rate: str, hint: str) -> None:
    trouble = feed(RateWatch(50.0, ("left", "right")), period_ns)
    assert trouble is not None
    assert trouble.startswith(f"starts {rate} frames a second where trigger.rate_hz is 50: ")
    assert hint in trouble


def test_a_camera_that_runs_by_its_own_clock_has_no_trigger_source_to_check() -> None:
    trouble = feed(RateWatch(50.0, ()), 25 * MS)
    assert "40.0 frames a second" in str(trouble) and "does not keep its configured rate" in str(trouble)


def test_a_wrong_rate_is_reported_while_it_lasts() -> None:
    watch = RateWatch(50.0, ("left",))
    assert feed(watch) is None
    assert feed(watch, PERIOD_NS // 2, first=100, count=3 * JUDGED_FRAMES) is not None
    assert feed(watch, first=200, count=3 * JUDGED_FRAMES) is None


def verdicts(watch: RateWatch, times_ns: Iterable[float]) -> list[str | None]:
    return [watch.frame("left", frame(number, round(time_ns))) for number, time_ns in enumerate(times_ns)]


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_triggers_on_a_grid_of_milliseconds_are_at_their_mean_rate(phase: int) -> None:
    times_ns = accumulate(islice(cycle([17 * MS, 17 * MS, 16 * MS]), phase, phase + 600))
    assert set(verdicts(RateWatch(60.0, ("left",)), times_ns)) == {None}


@pytest.mark.parametrize("jitter_ms", [0.8, 1.5])
def test_jitter_is_not_a_wrong_rate(jitter_ms: float) -> None:
    scatter_ns = np.random.default_rng(7).normal(0.0, jitter_ms * MS, 20_000)
    times_ns = np.arange(20_000) * 1e9 / 60 + scatter_ns
    assert set(verdicts(RateWatch(60.0, ("left",)), times_ns)) == {None}
    slow = verdicts(RateWatch(60.0, ("left",)), np.arange(6_000) * 1e9 / 58.8 + scatter_ns[:6_000] * 0.8 / jitter_ms)
    assert None not in slow[TWO_WINDOWS:]
    assert mean_period_ns([10.0, 20.0] * 10) == 15.0  # every second trigger now and then


def test_a_rate_at_the_edge_of_the_tolerance_gets_one_verdict_and_keeps_it() -> None:
    scatter_ns = np.random.default_rng(7).normal(0.0, 0.3 * MS, 20_000)
    seen = verdicts(RateWatch(60.0, ("left",)), np.arange(20_000) * 1e9 / 60 * 1.01 + scatter_ns)
    assert sum(before != after for before, after in pairwise(seen)) <= 1


@pytest.mark.parametrize("jump_ms", [-3_600_000, -300, -7, 7, 300, 3_600_000])
@pytest.mark.parametrize("lasts", [1, 10_000])
def test_pauses_clock_jumps_and_stray_time_stamps_are_not_a_wrong_rate(jump_ms: int, lasts: int) -> None:
    for at in range(JUDGED_FRAMES, 2 * JUDGED_FRAMES + 2):
        times_ns = [number * PERIOD_NS + jump_ms * MS * (at <= number < at + lasts) for number in range(200)]
        assert set(verdicts(RateWatch(50.0, ("left",)), times_ns)) == {None}


def test_lost_frames_pauses_and_reopened_cameras_are_not_a_wrong_rate() -> None:
    watch = RateWatch(50.0, ("left",))
    times = [number for number in range(200) if number % 3] + list(range(400, 440))
    assert {watch.frame("left", frame(number, number * PERIOD_NS)) for number in times} == {None}
    watch.gone("left")
    assert feed(watch) is None


@pytest.mark.parametrize(("rate_hz", "reported"), [(59.0, True), (59.7, False), (60.3, False), (61.0, True)])
def test_one_frame_a_second_too_few_or_too_many_is_a_wrong_rate(rate_hz: float, reported: bool) -> None:
    assert (wrong_rate(1e9 / rate_hz, 60.0) is not None) == reported


def test_triggers_that_the_host_gives_may_be_left_out_but_not_every_second_one() -> None:
    cameras: tuple[CameraName, ...] = ("left", "right")
    assert feed(RateWatch(50.0, cameras, HOST_RATE_TOLERANCE), PERIOD_NS * 23 // 20) is None
    assert "fit into one period" in (feed(RateWatch(50.0, cameras, HOST_RATE_TOLERANCE), 2 * PERIOD_NS) or "")


@pytest.mark.parametrize("apart_ns", [100_000, 5_000_000])
@pytest.mark.parametrize("first", [0, 1])
def test_cameras_that_start_apart_do_not_change_the_period(apart_ns: int, first: int) -> None:
    """Nor does it matter whose frame arrives first."""
    period_ns = 1e9 / 60 * (1 + 20e-6)
    grid = TriggerGrid(1e9 / 60, 0)
    for trigger in range(3000):
        times_ns = [round(trigger * period_ns), round(trigger * period_ns) + apart_ns]
        for time_ns in (times_ns[first], times_ns[1 - first]):
            grid.observe(grid.locate(time_ns), time_ns)
    assert grid.period_ns == pytest.approx(period_ns, rel=1e-6)


def check(rate_hz: float = 50.0) -> StartCheck:
    judge = StartCheck(dict.fromkeys(SIDES, "Line0"), rate_hz)
    for camera in SIDES:
        judge.ready(camera, 0)
    return judge


def show(
    judge: StartCheck, camera: CameraName, period_ns: int = 20 * MS, offset_ns: int = 0, frames: int = JUDGED_FRAMES
) -> None:
    for number in range(frames):
        judge.frame(camera, offset_ns + number * period_ns)


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
    show(judge, "left")
    for period_ns, offset_ns, frames in right:
        show(judge, "right", period_ns, offset_ns, frames)
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
    show(judge, "left")
    the_finding(judge, PATIENCE_NS + 1, "the right camera gets no trigger pulse")
    for cameras in (("right",), SIDES):
        judge = check()
        if "left" not in cameras:
            show(judge, "left")
        for camera in cameras:
            judge.frame(camera, None)
        assert judge.findings(PATIENCE_NS + 1) == []


def test_a_camera_that_is_lost_before_its_first_frame_says_nothing_about_its_wire_until_it_has_waited_again() -> None:
    judge = check()
    show(judge, "left")
    judge.gone("right")
    assert judge.findings(PATIENCE_NS + 1) == []
    judge.ready("right", 10 * PATIENCE_NS)
    assert judge.findings(11 * PATIENCE_NS) == []
    the_finding(judge, 11 * PATIENCE_NS + 1, "the right camera gets no trigger pulse")
    judge = check()
    judge.gone("right")
    the_finding(judge, PATIENCE_NS + 1, "no trigger pulse on Line0")
    judge = check()
    show(judge, "left")
    show(judge, "right", frames=3)
    judge.gone("right")
    judge.ready("right", PATIENCE_NS)  # it has had pulses before
    assert judge.findings(3 * PATIENCE_NS) == []


@pytest.mark.parametrize("offset_ms", [-7, 4, 10, 13])
def test_cameras_that_start_apart_are_reported(offset_ms: int) -> None:
    judge = check()
    show(judge, "left")
    show(judge, "right", offset_ns=offset_ms * MS)
    the_finding(judge, 0, f"{min(abs(offset_ms), 20 - abs(offset_ms)):.1f} ms apart")


def test_cameras_at_another_rate_or_in_step_are_not_apart() -> None:
    judge = check()
    show(judge, "left", 25 * MS)
    show(judge, "right", 25 * MS, 7 * MS)
    assert judge.findings(0) == []
    judge = check()
    for camera in SIDES:  # the difference counts, not when each began
        show(judge, camera, offset_ns=6 * MS)
    assert judge.findings(0) == []
    judge, period_ns = check(), 20 * MS + 2_000  # 100 ppm, and one begins a minute later
    show(judge, "left", period_ns, frames=3000)
    for number in range(3000, 3000 + JUDGED_FRAMES):
        for camera in SIDES:
            judge.frame(camera, number * period_ns)
    assert judge.findings(PATIENCE_NS) == []


def test_cameras_on_a_grid_of_milliseconds_are_judged() -> None:
    judge = check(60.0)
    for number in range(JUDGED_FRAMES):
        judge.frame("left", -(-number * 50 // 3) * MS)
        judge.frame("right", (-(-number * 50 // 3) + 5) * MS)
    the_finding(judge, 0, "5.0 ms apart")


def test_cameras_that_the_host_triggers_are_sent_to_no_wire() -> None:
    judge = StartCheck(dict.fromkeys(SIDES, "Software"), 50.0, by_host=True)
    for camera in SIDES:
        judge.ready(camera, 0)
    the_finding(judge, PATIENCE_NS + 1, "no frame for 3 s", "network")
    show(judge, "left")
    the_finding(judge, PATIENCE_NS + 2, "no frame from the right camera", "cable")
    show(judge, "right", offset_ns=5 * MS)
    the_finding(judge, PATIENCE_NS + 3, "5.0 ms apart", "too busy")


def test_cameras_that_run_freely_have_no_pulses_to_miss() -> None:
    """In the mode "primary" that is the left one."""
    judge = StartCheck({"right": "Line0"}, 50.0)
    for camera in SIDES:
        judge.ready(camera, 0)
    show(judge, "left", 40 * MS)
    the_finding(judge, PATIENCE_NS + 1, "no trigger pulse on Line0")


def test_late_pulses_give_no_finding_before_both_cameras_could_show_them() -> None:
    judge = check()
    the_finding(judge, PATIENCE_NS + 1, "no trigger pulse")
    judge.frame("left", PATIENCE_NS)
    assert judge.findings(PATIENCE_NS + 2) == []
