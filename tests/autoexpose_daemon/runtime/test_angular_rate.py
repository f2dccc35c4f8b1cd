"""Which angular rate a decision uses, and what is logged while there is none."""

from __future__ import annotations

import logging

import pytest

from autoexpose_daemon.config.document import ImuConfig
from autoexpose_daemon.runtime.inputs import AngularRate
from autoexpose_daemon.status.counters import Counts

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
