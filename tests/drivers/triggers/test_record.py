"""The record of a rig, from its events; and the watch over its clocks, reading by reading."""

from __future__ import annotations

import numpy as np

from drivers.camera import CameraDescription, ClockReading, IncompleteFrame, PtpState
from drivers.rig.events import CameraGone, CameraReady, FrameArrived, WriteFailed, Written
from drivers.rig.supervision import Slots
from drivers.triggers import RigRecord
from drivers.triggers.host import LOST_NS, STEP_NS, SYNCHRONISED_NS, Synchronisation
from drivers.triggers.host import PATIENCE_NS as SYNC_PATIENCE_NS
from drivers.triggers.outcomes import LossReason
from drivers.triggers.rate import JUDGED_FRAMES, PATIENCE_NS
from imaging.errors import CameraLostError, NodeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame
from imaging.geometry import SIDES

MS = 1_000_000
PERIOD_NS = 20 * MS
OLD, NEW = ExposureSetting(1000.0, 0.0), ExposureSetting(2000.0, 6.0)
LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)


def frame(trigger: int, setting: ExposureSetting = OLD) -> Frame:
    time_ns = trigger * PERIOD_NS
    return Frame(np.zeros((2, 2), np.uint8), 8, trigger, time_ns, time_ns, time_ns + 5 * MS, setting)


def opened_record() -> RigRecord:
    """Of two cameras that hold `OLD`, and have made a pair of trigger 0."""
    record = RigRecord(SIDES, dict.fromkeys(SIDES, "Line0"), 50.0, -PERIOD_NS // 2)
    for camera in SIDES:
        assert record.written(Written(camera, OLD, OLD, -9 * MS, -8 * MS)) is None  # no command is behind it
        assert record.take(CameraReady(camera, CameraDescription("V", "M", camera), LIMITS), -7 * MS) == []
    arrive(record, 0)
    return record


def arrive(record: RigRecord, trigger: int, *cameras: CameraName, setting: ExposureSetting = OLD) -> list[int]:
    """Frames of a trigger; the triggers of the pairs that are returned."""
    events = [FrameArrived(camera, frame(trigger, setting)) for camera in cameras or SIDES]
    return [pair.trigger for event in events for pair in record.take(event, trigger * PERIOD_NS + 5 * MS)]


def test_frames_become_pairs_and_every_trigger_is_accounted_for() -> None:
    record = opened_record()
    assert arrive(record, 1) == [1]
    assert record.take(FrameArrived("left", IncompleteFrame(2, 2 * PERIOD_NS)), 0) == []
    arrive(record, 2, "right")
    assert arrive(record, 3) == [3]
    record.close(3 * PERIOD_NS + 10 * MS)
    assert (record.tally.pairs, dict(record.tally.lost)) == (3, {LossReason.INCOMPLETE: 1})


def test_frames_that_control_cannot_use_and_lost_cameras_say_nothing_against_the_wire() -> None:
    gone = CameraGone("left", CameraLostError("unplugged"), final=False)
    for event, stale in ((FrameArrived("left", IncompleteFrame(1, None)), True), (gone, False)):
        record = RigRecord(SIDES, dict.fromkeys(SIDES, "Line0"), 50.0, 0)
        for camera in SIDES:
            record.take(CameraReady(camera, CameraDescription("V", "M", camera), LIMITS), 0)
        record.take(event, MS)
        for trigger in range(JUDGED_FRAMES):
            record.take(FrameArrived("right", frame(trigger), stale=stale), PERIOD_NS)
        assert record.findings(PATIENCE_NS + 1) == []


def test_triggers_count_from_the_beginning_unless_they_wait_for_the_first_paced_camera() -> None:
    for mode, triggers in (("external", 3), ("ptp", 0)):
        record = RigRecord(SIDES, dict.fromkeys(SIDES, "Line0"), 50.0, 0, mode)  # type: ignore[arg-type]
        record.begin(10 * PERIOD_NS)
        record.close(13 * PERIOD_NS)
        assert record.tally.triggers == triggers


def test_a_command_is_followed_from_its_decision_to_the_frame_that_shows_it() -> None:
    record = opened_record()
    command = record.command(NEW, arrival_ns=5 * MS, decided_ns=8 * MS)
    assert (command.due_ns, command.held) == (8 * MS, False)
    for camera in SIDES:
        assert record.written(Written(camera, NEW, NEW, 8 * MS, 9 * MS, command.number)) is command
    assert record.late_writes == 0
    shown = frame(1, NEW)
    assert record.history("left").first_effect_ns(shown) == PERIOD_NS - 8 * MS
    assert record.history("left").first_effect_ns(shown) is None


def test_a_command_shortly_before_an_exposure_is_held() -> None:
    command = opened_record().command(NEW, arrival_ns=5 * MS, decided_ns=19 * MS)
    assert command.held
    assert PERIOD_NS < command.due_ns < PERIOD_NS + MS


def test_a_refused_write_leaves_the_nodes_in_doubt_and_a_lost_camera_has_nothing_on_its_way() -> None:
    record = opened_record()
    assert record.history("left").held_since(0) == [OLD]
    record.take(WriteFailed("left", NEW, NodeError("refused")), 9 * MS)
    assert record.history("left").held_since(0) is None
    command = record.command(NEW, arrival_ns=5 * MS, decided_ns=8 * MS)
    record.take(CameraGone("right", CameraLostError("pulled"), final=False), 10 * MS)
    assert record.written(Written("left", NEW, NEW, 8 * MS, 11 * MS, command.number)) is command
    assert record.written(Written("right", NEW, NEW, 500 * MS, 501 * MS, command.number)) is None


def test_a_mismatch_is_explained_while_only_one_camera_has_the_new_setting() -> None:
    record = opened_record()
    command = record.command(NEW, arrival_ns=5 * MS, decided_ns=8 * MS)
    record.written(Written("left", NEW, NEW, 8 * MS, 9 * MS, command.number))
    (pair,) = (
        pair
        for camera, setting in (("left", NEW), ("right", OLD))
        for pair in record.take(FrameArrived(camera, frame(1, setting)), 25 * MS)
    )
    assert record.mismatched(pair)
    assert record.explains_mismatch(pair)


S = 1_000_000_000
PTP_OFFSET_NS = -1_700_000_000 * S
"""Host time minus PTP time."""


class Readings:
    def __init__(self) -> None:
        self.sync = Synchronisation(10.0)
        self.now_ns = 100 * S
        self.slots: dict[CameraName, Slots] = {}
        for camera in ("left", "right"):
            self.sync.ready(camera, 10, self.now_ns)

    def read(
        self, camera: CameraName, status: str = "Slave", off_ns: int | None = 0, host_ns: int = PTP_OFFSET_NS
    ) -> None:
        self.now_ns += S // 2
        self.slots |= self.sync.read(camera, ClockReading(host_ns, PtpState(status, off_ns)), self.now_ns)

    def synchronised(self) -> Readings:
        for camera in ("left", "right", "left", "right"):
            self.read(camera)
        assert self.slots.keys() == {"left", "right"}
        return self


def test_triggers_begin_with_a_whole_second_when_both_clocks_have_been_good_twice() -> None:
    readings = Readings()
    for camera in ("left", "right", "left"):
        readings.read(camera)
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
    while readings.now_ns < 100 * S + SYNC_PATIENCE_NS:
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
    for camera in ("left", "right"):
        readings.read(camera, host_ns=jumped_ns)
    after = readings.slots["left"]
    assert readings.slots["right"] == after
    assert after.first_ns == before.first_ns
    assert after.device_first_ns == after.first_ns - jumped_ns


def test_a_small_correction_moves_no_slot_in_ptp_time() -> None:
    readings = Readings().synchronised()
    before = readings.slots["left"]
    readings.read("left", host_ns=PTP_OFFSET_NS + STEP_NS // 2)
    assert readings.slots["left"].device_first_ns == before.device_first_ns
