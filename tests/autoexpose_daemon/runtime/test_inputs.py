"""Which angular rates, light ahead and reports on tracking a decision uses, and why not others."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.config.document import ImuConfig
from autoexpose_daemon.control.inputs import (
    COLUMNS,
    ROWS,
    WIDEST_SPREAD_FRAMES,
    WINDOW_FRAMES,
    LightSeries,
    TrackedCells,
)
from autoexpose_daemon.control.picture.steering import FORGOTTEN_S, MOST_CONSUMERS, CellExposure
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.messages.frames import Stamping
from autoexpose_daemon.runtime.inputs import (
    APART_NS,
    MOST_WAITING,
    OLDEST_LIGHT_S,
    OLDEST_REPORT_S,
    AngularRate,
    ForetoldLight,
    Tracking,
)
from autoexpose_daemon.status.counters import Counts
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet

STEP_NS = 16_666_666
BEGINS = "image speed comes from optical flow: "
ENDS = "image speed comes from the IMU"


class Imu:
    """A rate in virtual time, asked for 60 times a second."""

    def __init__(self, max_age_s: float = 0.1) -> None:
        self.now_ns = 0
        self.counts = Counts()
        self.rate = AngularRate(ImuConfig(key="imu/data", max_age_s=max_age_s), self.counts, lambda: self.now_ns)

    def ask(self, steps: int, sample: float | None = None) -> list[float | None]:
        """What control gets, with a sample before each step, or none."""
        rates = []
        for _ in range(steps):
            self.now_ns += STEP_NS
            if sample is not None:
                self.rate.take(sample)
            rates.append(self.rate(0))
        return rates


@pytest.fixture
def imu(caplog: pytest.LogCaptureFixture) -> Imu:
    caplog.set_level(logging.INFO)
    return Imu()


def test_the_newest_sample_counts_until_it_is_too_old(imu: Imu, caplog: pytest.LogCaptureFixture) -> None:
    imu.rate.take(9.0)
    assert imu.ask(1, 1.5) == [1.5]
    assert imu.ask(8) == [1.5] * 6 + [None] * 2  # 6 steps are 0.1 s
    assert imu.counts.decisions_without_imu == 2
    assert (imu.rate.tally.samples, imu.rate.tally.angular_rate_rad_s) == (2, None)
    assert caplog.messages == [BEGINS + "no IMU sample as imu/data for more than 0.1 s"]


def test_a_missing_imu_is_logged_once_and_so_is_its_return(imu: Imu, caplog: pytest.LogCaptureFixture) -> None:
    imu.ask(100)
    assert imu.rate.tally.trouble == "no IMU sample as imu/data yet"
    assert imu.ask(60, 0.5) == [0.5] * 60  # used at once, though it counts as back after a second
    assert imu.rate.tally.trouble
    imu.ask(2, 0.5)
    assert imu.rate.tally.trouble == ""
    assert caplog.messages == [BEGINS + "no IMU sample as imu/data yet", ENDS]
    assert imu.counts.decisions_without_imu == 100


def test_an_imu_that_is_too_slow_is_logged_once(imu: Imu, caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(50):
        imu.rate.take(0.5)
        assert None in imu.ask(10)
    assert caplog.messages == [BEGINS + "no IMU sample as imu/data for more than 0.1 s"]


def test_why_there_is_no_rate_is_always_the_latest_reason(imu: Imu) -> None:
    imu.rate.no_source = "zenoh, tcp/127.0.0.1:7447: no"
    imu.ask(1)
    assert imu.rate.tally.trouble == "zenoh, tcp/127.0.0.1:7447: no"
    imu.rate.no_source = ""
    imu.rate.refuse()
    imu.ask(1)
    assert imu.rate.tally.trouble == "imu/data does not carry an angular velocity in rad/s"
    imu.ask(1, 1.0)
    imu.ask(10)
    assert imu.rate.tally.trouble == "no IMU sample as imu/data for more than 0.1 s"
    assert imu.rate.tally.refused == 1


def test_one_bad_message_among_good_ones_changes_nothing(imu: Imu, caplog: pytest.LogCaptureFixture) -> None:
    imu.ask(5, 1.0)
    imu.rate.refuse()
    assert imu.ask(3) == [1.0] * 3
    assert caplog.messages == []


def test_no_rate_is_shown_beside_the_reason_why_none_is_used(imu: Imu, monkeypatch: pytest.MonkeyPatch) -> None:
    """The status is read on another thread, which may look while the reason is being logged."""
    seen = []
    monkeypatch.setattr(
        "autoexpose_daemon.runtime.inputs.log.warning",
        lambda *_: seen.append((bool(imu.rate.tally.trouble), imu.rate.tally.angular_rate_rad_s)),
    )
    imu.ask(1, 1.0)
    imu.ask(10)
    assert seen == [(True, None)]


DEGREES = "by imu/data the camera turned right round within a second: is that in degrees, not rad/s?"


@pytest.mark.parametrize("degrees_s", [7.0, 30.0, 90.0])
def test_an_imu_in_degrees_is_not_believed_once_it_turns(
    imu: Imu, caplog: pytest.LogCaptureFixture, degrees_s: float
) -> None:
    """Nor in between: a robot that goes straight on turns a little, too."""
    rates = imu.ask(100, degrees_s)
    assert rates.count(None) >= 35
    assert imu.ask(600, 2.0) == [None] * 600
    assert imu.ask(100, degrees_s)[-1] is None
    assert caplog.messages == [BEGINS + DEGREES]
    assert imu.rate.tally.trouble == DEGREES


def test_an_imu_in_degrees_that_goes_silent_is_missing(imu: Imu) -> None:
    imu.ask(100, 30.0)
    imu.ask(10)
    assert imu.rate.tally.trouble == "no IMU sample as imu/data for more than 0.1 s"


def test_a_robot_that_spins_for_a_moment_is_believed(imu: Imu) -> None:
    for _ in range(20):
        assert imu.ask(50, 20.0) == [20.0] * 50
        assert imu.ask(5, 3.0) == [3.0] * 5


def test_an_imu_is_believed_again_a_minute_after_the_last_impossible_turn(imu: Imu) -> None:
    imu.ask(100, 30.0)
    assert imu.ask(61 * 60, 0.5)[-1] == 0.5
    imu.ask(61, 0.5)
    assert imu.rate.tally.trouble == ""


RATE_HZ = 50.0
CAME_NS = 7_000_000_000
MOUTH_S = 0.3


class Clock:
    now_ns = CAME_NS

    def __call__(self) -> int:
        return self.now_ns


def told(clock: Clock, spread_s: float = 0.05) -> ForetoldLight:
    """Light that falls by 6 stops `MOUTH_S` after the series came."""
    light = ForetoldLight(RATE_HZ, clock)
    times_s = (np.arange(221) - 120) * 0.02
    fallen = np.where(times_s < MOUTH_S, 0.0, 6.0)
    light.take(LightSeries(8.0 + fallen, -fallen, 120, 0.02, spread_s))
    return light


@pytest.mark.parametrize(("taken_s", "frames"), [(0.0, 15), (0.2, 5), (-0.1, 20), (0.4, -5)])
def test_the_mouth_is_as_many_frames_ahead_as_fit_into_the_time_to_it(taken_s: float, frames: int) -> None:
    clock = Clock()
    light = told(clock)
    clock.now_ns = CAME_NS + round(0.41e9)
    ahead = light(CAME_NS + round(taken_s * 1e9))
    assert ahead is not None and ahead.spread_frames == pytest.approx(0.05 * RATE_HZ)
    assert ahead.now >= WINDOW_FRAMES
    mouth = next(index for index, level in enumerate(ahead.levels) if level > 11.0)
    assert mouth - ahead.now == pytest.approx(frames, abs=1)
    assert ahead.risen == tuple(8.0 - level for level in ahead.levels)


def test_what_is_old_or_vague_or_was_never_told_is_not_used() -> None:
    clock = Clock()
    assert ForetoldLight(RATE_HZ, clock)(CAME_NS) is None
    assert told(clock, spread_s=1.01 * WIDEST_SPREAD_FRAMES / RATE_HZ)(CAME_NS) is None
    light = told(clock)
    clock.now_ns = CAME_NS + round(OLDEST_LIGHT_S * 1e9)
    assert light(clock.now_ns) is not None
    clock.now_ns += 1
    assert light(clock.now_ns) is None


def test_at_a_low_rate_the_series_reaches_as_far_back_as_it_was_told() -> None:
    slow = LightSeries(np.full(221, 8.0), np.zeros(221), 120, 0.02, 0.05).in_frames(0.0, 10.0)
    assert slow is not None and slow.now == 24


SECOND = 1_000_000_000
SETTING = ExposureSetting(1000.0, 0.0)
PERIOD_NS = SECOND // 60
NOW_NS = 70 * SECOND
CELLS = np.full((ROWS, COLUMNS), 20, np.uint16)
WELL = CellExposure(np.ones((ROWS, COLUMNS), np.float32), np.ones((ROWS, COLUMNS), np.float32))


class Run:
    """Two seconds of frames, the newest now."""

    def __init__(self, cameras: tuple[CameraName, ...] = ("left", "right")) -> None:
        self.now_ns = NOW_NS
        self.tracking = Tracking(cameras, 60.0, now_ns=lambda: self.now_ns)
        for number in range(120, -1, -1):
            self.tracking.saw(NOW_NS - number * PERIOD_NS, dict.fromkeys(cameras, WELL))

    def report(self, taken_ns: int = NOW_NS, consumer: str = "slam", camera: CameraName = "left") -> str | None:
        """Why a report is refused."""
        before = dict(self.tracking.tally.refused)
        self.tracking.take(TrackedCells(consumer, 0, camera, CELLS, CELLS), taken_ns)
        self.tracking(self.now_ns)
        refused = [name for name, count in self.tracking.tally.refused.items() if count != before[name]]
        return refused[0] if refused else None


def test_a_report_on_a_frame_that_control_has_seen_steers() -> None:
    run = Run()
    assert run.tracking(NOW_NS) is None
    assert run.report(NOW_NS - 30 * PERIOD_NS) is None
    steering = run.tracking(NOW_NS)
    assert steering is not None and (steering.by, steering.age_s) == (("slam",), 0.5)
    assert run.tracking.tally.reports == 1
    pair = FrameSet(0, {"left": Frame(np.zeros((1, 1), np.uint8), 8, 0, NOW_NS, NOW_NS, NOW_NS, SETTING)})
    loop: Any = SimpleNamespace(steered=True, cell_exposures={"left": WELL})
    run.tracking.decided(StepInputs(pair, steering=steering), [loop])
    assert str(run.tracking.tally) == "by slam, age 0.5 s   reports: 1, refused: none"
    assert run.tracking(NOW_NS + round(FORGOTTEN_S * SECOND)) is None


@pytest.mark.parametrize(
    ("taken_ns", "why"),
    [
        (NOW_NS - APART_NS, None),
        (NOW_NS - APART_NS - 1, "unknown_frame"),
        (NOW_NS + APART_NS, None),
        (NOW_NS + APART_NS + 1, "future"),
        (NOW_NS + (1 << 62), "future"),
        (NOW_NS - 59 * PERIOD_NS, None),
        (NOW_NS - round(OLDEST_REPORT_S * SECOND) - 1, "stale"),
        (-(1 << 62), "stale"),
    ],
)
def test_a_stamp_must_be_that_of_a_frame_of_late(taken_ns: int, why: str | None) -> None:
    assert Run().report(taken_ns) == why


def test_a_report_on_a_frame_with_a_stamp_of_ptp_time_is_known_for_what_it_is() -> None:
    """The host's clock may show anything."""
    stamping, loop = Stamping("middle", 37), SimpleNamespace(steered=True, cell_exposures={"left": WELL})
    tracking = Tracking(("left",), 60.0, stamping, now_ns=lambda: NOW_NS + 20_000_000)
    ptp_ns = 1_700_000_000 * SECOND
    frame = Frame(np.zeros((1, 1), np.uint8), 8, 0, ptp_ns, NOW_NS, NOW_NS, SETTING, ptp_time_ns=ptp_ns)
    tracking.decided(StepInputs(FrameSet(0, {"left": frame})), [loop])  # type: ignore[list-item]
    stamp_ns = ptp_ns + 500_000 - 37 * SECOND
    for off_ns in (0, 37 * SECOND):
        taken_ns = tracking.taken_ns(stamp_ns + off_ns, realtime_offset_ns=12345)
        tracking.take(TrackedCells("slam", 0, "left", CELLS, CELLS), taken_ns)
    tracking(NOW_NS + 20_000_000)
    assert (tracking.tally.reports, tracking.tally.refused["future"]) == (1, 1)


def test_a_report_before_any_frame_or_on_a_camera_that_was_missing_is_refused() -> None:
    tracking = Tracking(("left", "right"), 60.0, now_ns=lambda: NOW_NS)
    seen: tuple[dict[CameraName, CellExposure], ...] = ({}, {"right": WELL})
    for frames in seen:
        tracking.take(TrackedCells("slam", 0, "left", CELLS, CELLS), NOW_NS)
        assert tracking(NOW_NS) is None
        tracking.saw(NOW_NS, frames)
    tracking.take(TrackedCells("slam", 0, "left", CELLS, CELLS), NOW_NS)
    assert tracking(NOW_NS) is None
    assert (tracking.tally.refused["unknown_frame"], tracking.tally.refused["passed_over"]) == (1, 2)


def test_a_camera_that_the_rig_does_not_have_cannot_be_reported_on(caplog: pytest.LogCaptureFixture) -> None:
    run = Run(("left",))
    with caplog.at_level(logging.WARNING):
        assert [run.report(camera="right") for _ in range(3)] == ["no_camera"] * 3
    assert caplog.messages == ["a report of consumer slam on its tracking is ignored: the rig has no right camera"]


def test_more_consumers_than_can_steer_are_refused_until_others_are_silent() -> None:
    run = Run()
    assert [run.report(consumer=f"c{number}") for number in range(MOST_CONSUMERS)] == [None] * MOST_CONSUMERS
    assert run.report(consumer="one more") == "too_many_consumers"
    assert run.report(consumer="c3") is None
    run.now_ns += round(FORGOTTEN_S * SECOND)
    run.tracking.saw(run.now_ns, {"left": WELL})
    assert run.report(run.now_ns, "one more") is None


def test_a_flood_between_two_frames_is_cut_and_counted() -> None:
    run = Run()
    for _ in range(MOST_WAITING + 100):
        run.tracking.take(TrackedCells("slam", 0, "left", CELLS, CELLS), NOW_NS)
    run.tracking(NOW_NS)
    assert (run.tracking.tally.reports, run.tracking.tally.refused["too_often"]) == (MOST_WAITING, 100)
