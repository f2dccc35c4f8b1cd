"""The record of a rig, from its events."""

from __future__ import annotations

import numpy as np

from drivers.camera import CameraDescription, IncompleteFrame
from drivers.rig.events import CameraGone, CameraReady, FrameArrived, WriteFailed, Written
from drivers.triggers import RigRecord
from drivers.triggers.outcomes import LossReason
from drivers.triggers.rate import JUDGED_FRAMES, PATIENCE_NS
from imaging.errors import CameraLostError, NodeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import SIDES, Frame, Side

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
    for side in SIDES:
        assert record.written(Written(side, OLD, OLD, -9 * MS, -8 * MS)) is None  # no command is behind it
        assert record.take(CameraReady(side, CameraDescription("V", "M", side), LIMITS), -7 * MS) == []
    arrive(record, 0)
    return record


def arrive(record: RigRecord, trigger: int, *sides: Side, setting: ExposureSetting = OLD) -> list[int]:
    """Frames of a trigger; the triggers of the pairs that are returned."""
    events = [FrameArrived(side, frame(trigger, setting)) for side in sides or SIDES]
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
        for side in SIDES:
            record.take(CameraReady(side, CameraDescription("V", "M", side), LIMITS), 0)
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
    for side in SIDES:
        assert record.written(Written(side, NEW, NEW, 8 * MS, 9 * MS, command.number)) is command
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
        for side, setting in (("left", NEW), ("right", OLD))
        for pair in record.take(FrameArrived(side, frame(1, setting)), 25 * MS)
    )
    assert record.mismatched(pair)
    assert record.explains_mismatch(pair)
