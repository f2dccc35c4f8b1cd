"""Whether frames start at the rate of the triggers, all along."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.exposure import ExposureSetting
from drivers.frames import Frame
from drivers.rate_watch import JUDGED_FRAMES, RateWatch, wrong_rate

MS = 1_000_000
PERIOD_NS = 20 * MS


def frame(frame_id: int, time_ns: int) -> Frame:
    return Frame(np.zeros((2, 2), np.uint8), 8, frame_id, time_ns, time_ns, time_ns, ExposureSetting(1000.0, 0.0))


def feed(watch: RateWatch, period_ns: int = PERIOD_NS, first: int = 0, count: int = JUDGED_FRAMES + 1) -> str | None:
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
def test_another_rate_is_told_with_its_likely_cause(period_ns: int, rate: str, hint: str) -> None:
    trouble = feed(RateWatch(50.0, ("left", "right")), period_ns)
    assert trouble is not None
    assert trouble.startswith(f"starts {rate} frames a second where trigger.rate_hz is 50: ")
    assert hint in trouble


def test_a_camera_that_runs_by_its_own_clock_has_no_trigger_source_to_check() -> None:
    trouble = feed(RateWatch(50.0, ()), 25 * MS)
    assert trouble == "starts 40.0 frames a second where trigger.rate_hz is 50: it does not run as it was told"


def test_it_is_told_while_it_lasts() -> None:
    watch = RateWatch(50.0, ("left",))
    assert feed(watch) is None
    assert feed(watch, PERIOD_NS // 2, first=100, count=2 * JUDGED_FRAMES) is not None
    assert feed(watch, first=200, count=2 * JUDGED_FRAMES) is None


def test_lost_frames_a_pause_and_a_camera_that_begins_anew_are_no_other_rate() -> None:
    watch = RateWatch(50.0, ("left",))
    times = [number for number in range(200) if number % 3] + list(range(400, 440))
    assert {watch.frame("left", frame(number, number * PERIOD_NS)) for number in times} == {None}
    watch.gone("left")
    assert feed(watch) is None


@pytest.mark.parametrize(("rate_hz", "told"), [(59.0, True), (59.7, False), (60.3, False), (61.0, True)])
def test_a_frame_a_second_too_few_or_too_many_is_another_rate(rate_hz: float, told: bool) -> None:
    assert (wrong_rate(1e9 / rate_hz, 60.0) is not None) == told
