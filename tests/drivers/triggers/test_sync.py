"""The watch over the clocks, reading by reading; drifting ones: autoexpose_daemon/runtime/test_host_triggers.py."""

from __future__ import annotations

from drivers.camera import ClockReading, PtpState
from drivers.rig.supervision import Slots
from drivers.triggers.host import LOST_NS, PATIENCE_NS, STEP_NS, SYNCHRONISED_NS, Synchronisation
from imaging.frames import Side

S = 1_000_000_000
PTP_OFFSET_NS = -1_700_000_000 * S
"""Host time minus PTP time."""


class Readings:
    def __init__(self) -> None:
        self.sync = Synchronisation(10.0)
        self.now_ns = 100 * S
        self.slots: dict[Side, Slots] = {}
        for side in ("left", "right"):
            self.sync.ready(side, 10, self.now_ns)

    def read(self, side: Side, status: str = "Slave", off_ns: int | None = 0, host_ns: int = PTP_OFFSET_NS) -> None:
        self.now_ns += S // 2
        self.slots |= self.sync.read(side, ClockReading(host_ns, PtpState(status, off_ns)), self.now_ns)

    def synchronised(self) -> Readings:
        for side in ("left", "right", "left", "right"):
            self.read(side)
        assert self.slots.keys() == {"left", "right"}
        return self


def test_triggers_begin_with_a_whole_second_when_both_clocks_have_been_good_twice() -> None:
    readings = Readings()
    for side in ("left", "right", "left"):
        readings.read(side)
    assert readings.slots == {}
    readings.read("right", off_ns=None)
    left, right = readings.slots["left"], readings.slots["right"]
    assert left == right
    assert left.device_first_ns is not None and left.device_first_ns % S == 0
    assert 0 <= left.first_ns - readings.now_ns < S


def test_a_clock_must_be_near_to_begin_and_far_to_be_lost() -> None:
    readings = Readings()
    for _ in range(3):
        readings.read("left", off_ns=SYNCHRONISED_NS + 1)
        readings.read("right", off_ns=-SYNCHRONISED_NS)
    assert readings.slots == {}
    readings = readings.synchronised()
    readings.read("left", off_ns=LOST_NS)
    assert readings.sync.trouble("left", readings.now_ns) is None
    readings.read("left", off_ns=-LOST_NS - 1)
    assert "no longer synchronised" in (readings.sync.trouble("left", readings.now_ns) or "")
    assert readings.sync.trouble("right", readings.now_ns) is None


def test_one_camera_may_be_the_master_of_the_other() -> None:
    readings = Readings()
    for _ in range(2):
        readings.read("left", "Master", off_ns=123_456_789)  # from when it was a slave
        readings.read("right")
    assert readings.slots.keys() == {"left", "right"}


def test_one_camera_is_not_kept_waiting_for_ever() -> None:
    readings = Readings()
    while readings.now_ns < 100 * S + PATIENCE_NS:
        readings.read("left")
        readings.read("right", "Uncalibrated", 300_000)
    readings.read("left")
    assert readings.slots.keys() == {"left"}
    assert "is not within 100 us of its PTP master's after 10 s" in (
        readings.sync.trouble("right", readings.now_ns) or ""
    )


def test_a_camera_that_lost_its_master_is_triggered_at_the_same_instants_by_its_own_clock() -> None:
    readings = Readings().synchronised()
    before = readings.slots["right"]
    own_ns = PTP_OFFSET_NS + 70_000
    readings.read("right", "Listening", host_ns=own_ns)
    after = readings.slots["right"]
    assert after.first_ns == before.first_ns
    assert after.device_first_ns == after.first_ns - own_ns
    assert readings.slots["left"] == before


def test_slots_go_on_where_they_are_when_the_master_is_set() -> None:
    readings = Readings().synchronised()
    before = readings.slots["left"]
    jumped_ns = PTP_OFFSET_NS - 37 * S
    for side in ("left", "right"):
        readings.read(side, host_ns=jumped_ns)
    after = readings.slots["left"]
    assert readings.slots["right"] == after
    assert after.first_ns == before.first_ns
    assert after.device_first_ns == after.first_ns - jumped_ns


def test_a_small_correction_moves_no_slot_in_ptp_time() -> None:
    readings = Readings().synchronised()
    before = readings.slots["left"]
    readings.read("left", host_ns=PTP_OFFSET_NS + STEP_NS // 2)
    assert readings.slots["left"].device_first_ns == before.device_first_ns
