"""Counters and clocks that lie, in virtual time: every trigger is a pair, and what lies is named once.

That these faults look like this on the wire is for tests/accept/test_clocks_and_counters.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from drivers.genicam.timeline import FrameTimeline
from drivers.triggers.account import TriggerAccount
from drivers.triggers.outcomes import LossReason
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side
from tests.autoexpose_daemon.virtual import VirtualRun
from tests.soak.camera import PIXELS, Device
from tests.soak.clock import MS, SECOND, Clock


def same(value: int) -> int:
    return value


@dataclass(frozen=True)
class Lie:
    """What a camera makes of its numbers and times, and what the log says of that."""

    says: str
    counter: Callable[[int], int] = same
    stamp: Callable[[int], int] = same
    latch: Callable[[int], int] = same

    def device(self, side: Side, clock: Clock, seed: int) -> Device:
        """The left camera tells it from the start; the right one is sound."""
        device = Device(side, clock, seed)
        if side == "left":
            self.tell(device)
        return device

    def tell(self, device: Device) -> None:
        device.counter, device.stamp, device.latch = self.counter, self.stamp, self.latch


LIES = {
    "zero_counter": Lie("frame counter went from", counter=lambda number: 0),
    "restart_counter": Lie("frame counter went from 100 to 1", counter=lambda number: (number - 1) % 100 + 1),
    "skip_counter": Lie("frame counter went from", counter=lambda number: number + 3 * (number // 10)),
    "double_counter": Lie("frame counter went from", counter=lambda number: 2 * number),
    "zero_stamps": Lie("its time stamps stand still", stamp=lambda ns: 0),
    "still_stamps": Lie("its time stamps stand still", stamp=lambda ns: 77 * SECOND),
    "microseconds": Lie("its time stamps went on by", stamp=lambda ns: ns // 1000),
    "picoseconds": Lie("its time stamps went on by", stamp=lambda ns: ns * 1000),
    "all_in_microseconds": Lie("its time stamps went on by", stamp=lambda ns: ns // 1000, latch=lambda ns: ns // 1000),
    "no clock at all": Lie("its time stamps stand still", stamp=lambda ns: 0, latch=lambda ns: 0),
    "wrap_stamps": Lie("32 bits and start again every 4.3 s", stamp=lambda ns: ns % 2**32, latch=lambda ns: ns % 2**32),
    "latch that is 0": Lie("its clock, as it is read", latch=lambda ns: 0),
    "latch of another clock": Lie("its clock, as it is read", latch=lambda ns: ns + 10**18),
}


def check(run: VirtualRun, lie: Lie, caplog: pytest.LogCaptureFixture) -> None:
    """Nothing is lost, nothing is degraded, and one line says why."""
    run.let_pass(300)
    counted = run.counted()
    counted.pop("clock_jumps", 0)  # when the lie begins
    assert counted == {}
    assert run.said == []
    assert caplog.text.count(lie.says) == 1
    skews_ns = [
        abs(pair.frames["left"].host_time_ns - pair.frames["right"].host_time_ns)
        for pair in run.pairs[-100:]
        if len(pair.frames) == 2
    ]
    assert max(skews_ns) < 3 * MS


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
def test_from_the_start(lie: Lie, caplog: pytest.LogCaptureFixture) -> None:
    check(VirtualRun(lie.device), lie, caplog)
    assert caplog.text.count("left camera: its ") <= 2
    assert "right camera: its " not in caplog.text
    assert "frames a second" not in caplog.text


@pytest.mark.parametrize("name", ["skip_counter", "zero_stamps", "still_stamps", "picoseconds", "wrap_stamps"])
def test_later(name: str, caplog: pytest.LogCaptureFixture) -> None:
    run, lie = VirtualRun(), LIES[name]
    lie.tell(run.left)
    check(run, lie, caplog)


@pytest.mark.parametrize("name", ["zero_counter", "microseconds", "latch that is 0"])
def test_of_both_cameras(name: str) -> None:
    run = VirtualRun()
    for device in (run.left, run.right):
        LIES[name].tell(device)
    run.let_pass(300)
    counted = run.counted()
    counted.pop("clock_jumps", 0)
    assert counted == {}


def test_a_lost_frame_is_still_counted_beside_a_lie() -> None:
    for lie in ("zero_counter", "double_counter", "zero_stamps", "microseconds"):
        run = VirtualRun(LIES[lie].device)
        run.left.lose = 3
        run.let_pass(20)
        run.right.lose = 2
        run.let_pass(20)
        assert run.counted() == {"left_missing": 3, "right_missing": 2}, lie


def test_a_counter_that_starts_again_when_the_camera_is_back_is_no_lie(caplog: pytest.LogCaptureFixture) -> None:
    run = VirtualRun()
    run.left.vanish()
    run.let_pass(60)
    run.left.present = True
    assert run.counted()["reconnects"] == 1
    assert "camera: its " not in caplog.text


@pytest.mark.parametrize("name", ["zero_counter", "restart_counter", "skip_counter", "double_counter", "zero_stamps"])
def test_in_free_run_each_frame_that_arrives_is_one_trigger(name: str) -> None:
    """A single camera, whose triggers are numbered by its frames; one of them is lost."""
    lie, period_ns = LIES[name], SECOND / 60
    timeline = FrameTimeline(period_ns, 0)
    account = TriggerAccount(("left",), period_ns, SECOND, numbered_by="frame_id")
    account.ready("left", SECOND)
    for number in range(1, 301):
        start_ns = round(SECOND + MS + (number - 1) * period_ns)
        if number == 150:
            continue
        placed = timeline.place(lie.counter(number), lie.stamp(start_ns), start_ns + 9 * MS, 2 * MS)
        assert placed.host_time_ns is not None
        setting = ExposureSetting(2000.0, 0.0)
        taken = Frame(PIXELS, 8, placed.frame_id, start_ns, placed.host_time_ns, start_ns + 9 * MS, setting)
        account.frame("left", taken)
    assert account.tally.pairs == 299
    assert dict(account.tally.lost) == {LossReason.LEFT_MISSING: 1}
    assert account.tally.surplus_frames == 0
