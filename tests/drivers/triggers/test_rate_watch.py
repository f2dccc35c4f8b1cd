"""Whether frames keep starting at the trigger rate."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate, cycle, islice, pairwise

import numpy as np
import pytest

from drivers.triggers.rate import HOST_RATE_TOLERANCE, JUDGED_FRAMES, RateWatch, TriggerGrid, mean_period_ns, wrong_rate
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side

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
        (25 * MS, "40.0", "configure its rate"),
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
    sides: tuple[Side, ...] = ("left", "right")
    assert feed(RateWatch(50.0, sides, HOST_RATE_TOLERANCE), PERIOD_NS * 23 // 20) is None
    assert "fit into one period" in (feed(RateWatch(50.0, sides, HOST_RATE_TOLERANCE), 2 * PERIOD_NS) or "")


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
