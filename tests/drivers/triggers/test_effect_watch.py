"""Whether frames are taken as was written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.exposure import ExposureSetting
from drivers.frames import Frame
from drivers.triggers.effect import ASTRAY_FRAMES, PATIENCE_NS, EffectWatch

PERIOD_NS = 16_666_667
OLD, NEW = ExposureSetting(2000.0, 0.0), ExposureSetting(500.0, 6.0)
PATIENCE = PATIENCE_NS // PERIOD_NS + 1


def frame(number: int, setting: ExposureSetting) -> Frame:
    time_ns = number * PERIOD_NS
    return Frame(np.zeros((2, 2), np.uint8), 8, number, time_ns, time_ns, time_ns, setting)


def test_a_camera_that_follows_within_half_a_second_is_not_talked_about() -> None:
    watch = EffectWatch()
    watch.written("left", OLD, -1)
    watch.written("left", NEW, 0)
    for number in range(PATIENCE):
        assert watch.frame("left", frame(number, OLD)) is None
    assert watch.frame("left", frame(PATIENCE, NEW)) is None
    assert watch.frames_off_setting == 0


def test_a_camera_that_stays_as_it_was_is_told_until_it_follows() -> None:
    watch = EffectWatch()
    watch.written("left", OLD, -1)
    watch.written("left", NEW, 0)
    told = [watch.frame("left", frame(number, OLD)) for number in range(PATIENCE + 2 * ASTRAY_FRAMES)]
    assert told[PATIENCE + ASTRAY_FRAMES - 2] is None
    assert told[-1] == (
        "its frames do not follow what is written: 500 us, 6.0 dB stands in its nodes, "
        "frames are taken with 2000 us, 0.0 dB; switch the camera off and on"
    )
    assert watch.frames_off_setting == 2 * ASTRAY_FRAMES
    assert watch.frame("left", frame(999, NEW)) is None


def test_a_few_frames_with_half_of_a_setting_are_no_sign() -> None:
    watch = EffectWatch()
    watch.written("left", NEW, 0)
    half = ExposureSetting(NEW.exposure_time_us, OLD.gain_db)
    told = [watch.frame("left", frame(number, half if number % ASTRAY_FRAMES else NEW)) for number in range(200)]
    assert set(told) == {None}


def test_of_a_camera_whose_frames_do_not_tell_or_whose_nodes_are_unknown_nothing_is_concluded() -> None:
    watch = EffectWatch()
    watch.written("left", NEW, 0)
    inferred = [replace(frame(number, OLD), setting_source="ledger") for number in range(100)]
    assert {watch.frame("left", each) for each in inferred} == {None}
    watch.gone("left")
    assert {watch.frame("left", frame(number, OLD)) for number in range(100)} == {None}


def test_a_camera_that_ignores_one_write_after_another_is_told() -> None:
    watch = EffectWatch()
    watch.written("left", OLD, -1)
    told = []
    for number in range(PATIENCE + 2 * ASTRAY_FRAMES):
        watch.written("left", NEW, number * PERIOD_NS)
        told.append(watch.frame("left", frame(number, OLD)))
    assert told[PATIENCE - 2] is None
    assert "do not follow what is written" in str(told[-1])
