"""The account of triggers, and the checks of a start, with any number of cameras."""

from __future__ import annotations

import random
from collections import Counter
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import IncompleteFrame
from drivers.rig.events import Written
from drivers.triggers import RigRecord
from drivers.triggers.account import TriggerAccount
from drivers.triggers.rate import PATIENCE_NS, START_FRAMES, StartCheck
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, FrameSet
from tests.drivers.triggers.test_account import OPENED_NS, PERIOD_NS, PHASE_NS, FakeRig, frame
from tests.drivers.triggers.test_record import MS, NEW, OLD, arrive
from tests.drivers.triggers.test_record import frame as taken

THREE: tuple[CameraName, ...] = ("front", "rear", "top")
WHOLE = "front rear top"


def begun() -> FakeRig:
    """Three cameras that have made two sets."""
    rig = FakeRig(THREE)
    rig.pulses(2)
    assert shown(rig.released[-2:]) == [(0, WHOLE), (1, WHOLE)]
    rig.released.clear()
    return rig


def shown(sets: list[FrameSet]) -> list[tuple[int, str]]:
    return [(each.trigger, " ".join(each.frames)) for each in sets]


@pytest.mark.parametrize("gone", THREE)
def test_while_a_camera_is_silent_the_frames_of_the_others_are_handed_out_together(gone: CameraName) -> None:
    rig, others = begun(), " ".join(camera for camera in THREE if camera != gone)
    rig.pulse(**{gone: "absent"})
    assert rig.released == []
    rig.pulse(**{gone: "silent"})
    rig.pulses(3, **{gone: "absent"})
    assert shown(rig.released) == [(trigger, others) for trigger in range(2, 7)]
    rig.pulse(**{gone: "goes"})
    rig.pulses(2, **{gone: "absent"})
    assert shown(rig.released[5:]) == [(trigger, others) for trigger in range(7, 10)]
    rig.pulses(3)
    whole = [each for each in rig.released[8:] if len(each.frames) == 3]  # the others' may come before its first one
    assert shown(whole) == [(trigger, WHOLE) for trigger in range(10, 13)]
    assert rig.close() == {"camera_gone": 8}
    assert rig.account.tally.pairs == 5
    assert rig.account.tally.frames == Counter(dict.fromkeys(THREE, 13)) - Counter({gone: 8})
    assert rig.account.tally.frames_lost == {gone: 8}


def test_a_frame_that_comes_after_all_makes_the_set_whole() -> None:
    rig = begun()
    rig.pulse(top="silent")
    assert shown(rig.released) == [(2, "front rear")]
    rig.released += rig.account.frame("top", frame(3, PHASE_NS + 2 * PERIOD_NS))
    assert shown(rig.released[1:]) == [(2, WHOLE)]
    assert rig.close() == {}
    assert rig.account.tally.pairs == 3


def test_a_camera_that_is_left_alone_is_not_waited_with() -> None:
    rig = begun()
    rig.pulse(front="silent", rear="silent")
    rig.pulses(2, front="absent", rear="absent")
    assert shown(rig.released) == [(2, "top"), (3, "top"), (4, "top")]
    rig.pulse(front="absent")  # the second one is back, the first one is not
    assert shown(rig.released[3:]) == [(5, "rear top")]


@pytest.mark.parametrize(
    ("does", "reason"),
    [
        (("missing", "frame", "frame"), "front_missing"),
        (("frame", "frame", "missing"), "top_missing"),
        (("frame", "missing", "missing"), "several_missing"),
        (("missing", "missing", "missing"), "several_missing"),
        (("missing", "incomplete", "frame"), "incomplete"),
        (("missing", "missing", "ignored"), "trigger_ignored"),
        (("missing", "frame", "stale"), "stale"),
    ],
)
def test_each_fate_of_three_frames_has_its_reason(does: tuple[str, ...], reason: str) -> None:
    rig = FakeRig(THREE)
    rig.pulses(3)
    rig.pulses(2, **dict(zip(THREE, does, strict=True)))
    rig.pulses(3)
    assert (rig.close(), rig.account.tally.pairs) == ({reason: 2}, 6)


def test_triggers_at_one_of_many_cameras_are_lost_until_it_shows_them() -> None:
    rig = FakeRig(THREE)
    rig.pulses(4, top="absent")
    rig.pulses(3)
    assert rig.close() == {"startup": 4}
    assert rig.account.tally.frames == {"front": 7, "rear": 7, "top": 3}


class Sent(NamedTuple):
    """What a camera made of a trigger, and when that arrives, in periods."""

    due: float
    camera: CameraName
    trigger: int
    fate: str


FATES = ("frame", "frame", "frame", "frame", "missing", "ignored", "incomplete", "stale", "silent")
TRIGGERS = 28
"""Fewer than a camera must ignore to be taken for silent."""


def course(seed: int, cameras: tuple[CameraName, ...], sound: float) -> list[Sent]:
    """What cameras that are late by up to three periods send; `sound` is the share of sets that are whole."""
    rng = random.Random(seed)
    late = {camera: rng.uniform(0.0, 3.0) for camera in cameras}
    sent = []
    for trigger in range(TRIGGERS):
        whole = trigger in (0, 1, TRIGGERS - 2, TRIGGERS - 1) or rng.random() < sound
        for camera in cameras:
            fate = "frame" if whole else rng.choice(FATES)
            sent.append(Sent(trigger + late[camera], camera, trigger, fate))
    return sorted(sent)


def play(account: TriggerAccount, sent: list[Sent]) -> list[FrameSet]:
    """Everything that is handed out."""
    frame_ids: Counter[CameraName] = Counter()
    sets: list[FrameSet] = []
    for _, camera, trigger, fate in sent:
        time_ns = PHASE_NS + trigger * PERIOD_NS
        frame_ids[camera] += fate != "ignored"
        frame_id = frame_ids[camera]
        match fate:
            case "silent":
                sets += account.silent(camera)
            case "frame":
                sets += account.frame(camera, frame(frame_id, time_ns))
            case "stale":
                sets += account.stale(camera, frame(frame_id, time_ns))
            case "incomplete":
                sets += account.incomplete(camera, IncompleteFrame(frame_id, time_ns))
    account.close(PHASE_NS + (TRIGGERS - 1) * PERIOD_NS + PERIOD_NS // 3)
    return sets


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 6), st.sampled_from([0.0, 0.5, 0.9]))
def test_whatever_cameras_lose_the_account_balances(seed: int, count: int, sound: float) -> None:
    cameras = tuple(f"c{number}" for number in range(count))
    sent = course(seed, cameras, sound)
    account = TriggerAccount(cameras, PERIOD_NS, OPENED_NS)
    sets = play(account, sent)
    tally = account.tally
    assert tally.pairs + tally.lost.total() == TRIGGERS
    assert {tally.frames[camera] + tally.frames_lost[camera] for camera in cameras} == {TRIGGERS}
    whole = [each.trigger for each in sets if len(each.frames) == count]
    assert len(whole) == tally.pairs
    assert whole == sorted(set(whole))
    assert all(len({shot.host_time_ns for shot in each.frames.values()}) == 1 for each in sets)
    assert all(list(each.frames) == [camera for camera in cameras if camera in each.frames] for each in sets)
    alone = [(each.trigger, camera) for each in sets if len(each.frames) < count for camera in each.frames]
    assert len(alone) == len(set(alone)), "a frame is handed out once in a set without all cameras"
    fates = {(trigger, camera): fate for _, camera, trigger, fate in sent}
    complete = [n for n in range(TRIGGERS) if all(fates[n, camera] == "frame" for camera in cameras)]
    assert set(whole) <= set(complete)
    if all(fate != "silent" for fate in fates.values()):
        assert whole == complete, "nobody was silent: each frame is waited for"
    for camera in cameras:
        arrived = sum(fates[n, camera] == "frame" for n in range(TRIGGERS))
        assert tally.frames[camera] == arrived


def test_a_setting_of_one_group_is_no_mismatch_with_another() -> None:
    record = RigRecord(THREE, dict.fromkeys(THREE, "Line0"), 50.0, -PERIOD_NS // 2, groups=[THREE[:2], THREE[2:]])
    for camera in THREE:
        record.written(Written(camera, OLD, OLD, -9 * MS, -8 * MS))
    arrive(record, 0, *THREE)
    command = record.command(NEW, 5 * MS, 8 * MS, THREE[2:])
    assert (command.number, command.cameras) == (1, ("top",))
    assert record.written(Written("top", NEW, NEW, 8 * MS, 9 * MS, command.number)) is command
    mixed = FrameSet(1, {camera: taken(1, NEW if camera == "top" else OLD) for camera in THREE})
    assert not record.mismatched(mixed)
    apart = FrameSet(1, {camera: taken(1, NEW if camera == "rear" else OLD) for camera in THREE})
    assert record.mismatched(apart)
    assert not record.explains_mismatch(apart), "nothing was written to this group"


def started(*apart_ns: int) -> StartCheck:
    """Of three cameras that begin so far apart."""
    check = StartCheck(dict.fromkeys(THREE, "Line0"), 50.0)
    for camera in THREE:
        check.ready(camera, 0)
    for number in range(START_FRAMES):
        for camera, later_ns in zip(THREE, apart_ns, strict=False):
            check.frame(camera, number * 20 * MS + later_ns)
    return check


def test_a_camera_that_starts_apart_from_the_first_is_named() -> None:
    assert started(0, 0, 0).findings(0) == []
    (finding,) = started(0, 0, 5 * MS).findings(0)
    assert "front and top start 5.0 ms apart" in finding
    first, second = started(5 * MS, 0, 0).findings(0)
    assert "front and rear" in first and "front and top" in second


def test_a_camera_without_pulses_beside_two_others_is_named() -> None:
    (finding,) = started(0, 0).findings(PATIENCE_NS + 1)
    assert "top camera gets no trigger pulse" in finding and "Line0" in finding


def test_a_command_is_for_all_cameras_unless_it_names_some() -> None:
    record = RigRecord(THREE, dict.fromkeys(THREE, "Line0"), 50.0, 0)
    assert record.command(ExposureSetting(100.0, 0.0), 0, 0).cameras == THREE
