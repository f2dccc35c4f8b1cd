"""Whether frames are taken with what was written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.rig.events import Written
from drivers.triggers.writes import PATIENCE_NS, SUSPECT_FRAMES, EffectWatch, WriteHistory
from imaging.exposure import ExposureSetting
from imaging.frames import Frame

PERIOD_NS = 16_666_667
OLD, NEW = ExposureSetting(2000.0, 0.0), ExposureSetting(500.0, 6.0)
PATIENCE = PATIENCE_NS // PERIOD_NS + 1


def frame(number: int, setting: ExposureSetting) -> Frame:
    time_ns = number * PERIOD_NS
    return Frame(np.zeros((2, 2), np.uint8), 8, number, time_ns, time_ns, time_ns, setting)


def written(setting: ExposureSetting, time_ns: int) -> Written:
    return Written("left", setting, setting, time_ns, time_ns)


def test_a_camera_that_follows_within_half_a_second_is_not_reported() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(OLD, -1))
    history.write(written(NEW, 0))
    for number in range(PATIENCE):
        assert watch.frame(frame(number, OLD), history) is None
    assert watch.frame(frame(PATIENCE, NEW), history) is None
    assert watch.frames_off_setting == 0


def test_a_camera_that_does_not_follow_is_reported_until_it_does() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(OLD, -1))
    history.write(written(NEW, 0))
    reported = [watch.frame(frame(number, OLD), history) for number in range(PATIENCE + 2 * SUSPECT_FRAMES)]
    assert reported[PATIENCE + SUSPECT_FRAMES - 2] is None
    for words in ("nodes hold 500 us, 6.0 dB", "frames are taken with 2000 us, 0.0 dB", "off and on"):
        assert words in str(reported[-1])
    assert watch.frames_off_setting == 2 * SUSPECT_FRAMES
    assert watch.frame(frame(999, NEW), history) is None


def test_a_few_frames_with_half_of_a_setting_are_ignored() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(NEW, 0))
    half = ExposureSetting(NEW.exposure_time_us, OLD.gain_db)
    reported = [watch.frame(frame(number, half if number % SUSPECT_FRAMES else NEW), history) for number in range(200)]
    assert set(reported) == {None}


def test_frames_without_metadata_and_unknown_nodes_give_no_verdict() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(NEW, 0))
    inferred = [replace(frame(number, OLD), setting_source="ledger") for number in range(100)]
    assert {watch.frame(each, history) for each in inferred} == {None}
    history.gone()
    assert {watch.frame(frame(number, OLD), history) for number in range(100)} == {None}


def test_a_camera_that_ignores_one_write_after_another_is_reported() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(OLD, -1))
    reported = []
    for number in range(PATIENCE + 2 * SUSPECT_FRAMES):
        history.write(written(NEW, number * PERIOD_NS))
        reported.append(watch.frame(frame(number, OLD), history))
    assert reported[PATIENCE - 2] is None
    assert "do not follow what is written" in str(reported[-1])
