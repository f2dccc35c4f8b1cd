"""Writes, which command made a frame, and whether frames are taken with what was written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.rig.events import Written
from drivers.triggers.rate import TriggerGrid
from drivers.triggers.writes import (
    EFFECT_TRIGGERS,
    PATIENCE_NS,
    SUSPECT_FRAMES,
    Command,
    EffectWatch,
    GroupWrites,
    WriteHistory,
)
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet, SettingSource
from imaging.geometry import SIDES

MS = 1_000_000
GRID = TriggerGrid(20 * MS, 0)
DIM, BRIGHT = ExposureSetting(1000.0, 0.0), ExposureSetting(4000.0, 6.0)


def wrote(camera: CameraName, setting: ExposureSetting, start_ms: int, end_ms: int) -> Written:
    return Written(camera, setting, setting, start_ms * MS, end_ms * MS, command=id(setting))


def pair(trigger: int, left: ExposureSetting, right: ExposureSetting, taken_ms: int = 0) -> FrameSet:
    black = np.zeros((2, 2), np.uint8)
    settings = zip(SIDES, (left, right), strict=True)
    return FrameSet(trigger, {camera: Frame(black, 8, 0, 0, taken_ms * MS, 0, setting) for camera, setting in settings})


def test_a_write_between_two_exposures_is_in_time() -> None:
    writes = GroupWrites(SIDES)
    writes.write(wrote("left", BRIGHT, 1, 500), None)  # before the first frame nothing is late
    writes.write(wrote("left", DIM, 1, 3), GRID)
    writes.write(wrote("right", DIM, 2, 19), GRID)
    assert writes.late == 0
    assert not writes.mismatched(pair(1, DIM, DIM))
    assert not writes.explains(pair(1, DIM, BRIGHT))


@pytest.mark.parametrize("spans", [((1, 21), (1, 3)), ((1, 3), (19, 21)), ((1, 3), (21, 23)), ((1, 21), (1, 23))])
def test_a_setting_that_an_exposure_cuts_in_two_is_late_once(spans: tuple[tuple[int, int], tuple[int, int]]) -> None:
    writes = GroupWrites(SIDES)
    writes.write(wrote("left", DIM, *spans[0]), GRID)
    writes.write(wrote("right", DIM, *spans[1]), GRID)
    assert writes.late == 1
    assert writes.explains(pair(1, BRIGHT, DIM))
    assert not writes.explains(pair(1 + EFFECT_TRIGGERS + 1, BRIGHT, DIM))


def both_written() -> GroupWrites:
    writes = GroupWrites(SIDES)
    for camera in ("left", "right"):
        writes.write(wrote(camera, BRIGHT, -19, -18), GRID)
    return writes


def test_no_write_is_awaited_from_a_lost_camera() -> None:
    writes = both_written()
    writes.gone("right")
    writes.write(wrote("left", DIM, 1, 3), GRID)
    writes.write(wrote("left", BRIGHT, 21, 23), GRID)
    assert writes.late == 0
    assert not writes.explains(pair(1, DIM, BRIGHT))


def test_a_setting_that_not_every_camera_has_yet_explains_a_mismatch() -> None:
    writes = both_written()
    writes.write(wrote("left", DIM, 1, 3), GRID)
    assert writes.explains(pair(1, DIM, BRIGHT))
    assert not writes.explains(pair(0, DIM, BRIGHT))
    writes.write(wrote("right", DIM, 4, 6), GRID)
    assert not writes.explains(pair(1, DIM, BRIGHT))
    assert writes.late == 0


def test_a_write_that_takes_longer_than_frames_do_explains_a_mismatch_meanwhile() -> None:
    """Exposures see its time and not yet its gain, and nobody has said yet that it is late."""
    writes = both_written()
    writes.command(Command(id(DIM), DIM, 0, 25 * MS, 25 * MS))
    half = ExposureSetting(DIM.exposure_time_us, BRIGHT.gain_db)
    assert not writes.explains(pair(1, half, half, 20))
    assert writes.explains(pair(2, half, half, 40))
    for camera in SIDES:
        writes.write(wrote(camera, DIM, 25, 36), GRID)
    assert not writes.explains(pair(2, half, half, 40))


def test_a_camera_that_refuses_all_writes_since_it_is_back_explains_mismatches() -> None:
    writes = both_written()
    writes.gone("left")
    writes.refused("left")
    writes.command(Command(id(DIM), DIM, 0, 1 * MS, 1 * MS))
    writes.write(wrote("right", DIM, 1, 3), GRID)
    writes.refused("left")
    assert writes.explains(pair(1, BRIGHT, DIM, 20))
    newer = replace(DIM)
    writes.command(Command(id(newer), newer, 0, 21 * MS, 21 * MS))
    for camera in SIDES:
        writes.write(wrote(camera, newer, 21, 23), GRID)
    assert not writes.explains(pair(1 + EFFECT_TRIGGERS + 1, BRIGHT, DIM, 120))


def test_a_setting_overtaken_on_its_way_to_a_camera_is_late() -> None:
    writes = both_written()
    writes.write(wrote("left", DIM, 1, 3), GRID)
    writes.write(wrote("left", BRIGHT, 21, 23), GRID)
    writes.write(wrote("right", BRIGHT, 22, 24), GRID)
    assert writes.late == 1
    assert writes.explains(pair(1, DIM, BRIGHT))
    writes.write(wrote("left", DIM, 141, 143), GRID)
    writes.write(wrote("right", DIM, 141, 143), GRID)
    assert writes.late == 1
    assert not writes.explains(pair(1 + EFFECT_TRIGGERS + 1, BRIGHT, DIM))


def test_cameras_that_differ_or_hold_half_a_setting_are_mismatched() -> None:
    writes = GroupWrites(SIDES)
    for camera in ("left", "right"):
        writes.write(wrote(camera, DIM, 1, 2), GRID)
        writes.write(wrote(camera, BRIGHT, 3, 4), GRID)
    half = ExposureSetting(BRIGHT.exposure_time_us, DIM.gain_db)
    assert writes.mismatched(pair(1, DIM, BRIGHT))
    assert writes.mismatched(pair(1, half, half))
    assert not writes.mismatched(pair(1, BRIGHT, BRIGHT))


def test_a_mismatch_is_explained_when_a_camera_took_something_else_and_said_so() -> None:
    writes = both_written()
    clipped = ExposureSetting(500.0, 0.0)
    writes.write(Written("left", DIM, clipped, 1 * MS, 3 * MS, command=id(DIM)), GRID)
    writes.write(wrote("right", DIM, 1, 3), GRID)
    assert writes.mismatched(pair(1, clipped, DIM))
    assert writes.explains(pair(1, clipped, DIM))
    assert not writes.explains(pair(1, DIM, clipped))
    assert not writes.explains(pair(1, clipped, BRIGHT))


PERIOD_NS = 16_666_667


def at(exposure_time_us: float, gain_db: float = 0.0) -> ExposureSetting:
    return ExposureSetting(exposure_time_us, gain_db)


def frame(time_ns: int, setting: ExposureSetting, source: SettingSource = "chunk") -> Frame:
    return Frame(np.zeros((1, 1), np.uint8), 8, 0, time_ns, time_ns, time_ns, setting, source)


def decided(setting: ExposureSetting, decided_ns: int, arrival_ns: int = 0) -> Command:
    return Command(id(setting), setting, arrival_ns, decided_ns, due_ns=decided_ns)


def written(asked: ExposureSetting, time_ns: int, read_back: ExposureSetting | None = None) -> Written:
    return Written("left", asked, read_back or asked, time_ns - 1, time_ns, command=id(asked))


def test_the_delay_lasts_until_the_first_frame_with_the_setting() -> None:
    history, other = WriteHistory(), WriteHistory()
    assert history.first_effect_ns(frame(0, at(1000))) is None
    history.command(decided(at(2000), 10))
    other.command(decided(at(2000), 10))
    assert history.first_effect_ns(frame(PERIOD_NS, at(1000))) is None
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(2001))) == 2 * PERIOD_NS - 10
    assert history.first_effect_ns(frame(3 * PERIOD_NS, at(2001))) is None
    assert other.first_effect_ns(frame(3 * PERIOD_NS, at(1999))) == 3 * PERIOD_NS - 10


def test_a_ramp_of_small_steps_shows_the_delay_of_each() -> None:
    history = WriteHistory()
    delays = []
    for number in range(20):  # each frame shows what was decided two frames before; a step is 0.3 %
        delays.append(history.first_effect_ns(frame(number * PERIOD_NS, at(1000 + 3 * max(number - 2, 0)))))
        history.command(decided(at(1000 + 3 * (number + 1)), number * PERIOD_NS + 1))
    assert delays[:3] == [None, None, None]
    assert set(delays[3:]) == {3 * PERIOD_NS - 1}


def test_an_overtaken_setting_is_not_mistaken_for_an_effect() -> None:
    history = WriteHistory()
    history.first_effect_ns(frame(0, at(1000)))
    history.command(decided(at(1005), 1))
    history.command(decided(at(1008), 2))
    assert history.first_effect_ns(frame(PERIOD_NS, at(1008))) == PERIOD_NS - 2
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(1005))) is None


def test_an_inferred_setting_or_a_loss_gives_no_delay() -> None:
    history = WriteHistory()
    history.command(decided(at(1000), PERIOD_NS))
    assert history.first_effect_ns(frame(PERIOD_NS - 1, at(1000))) is None  # it began before the decision
    history.command(decided(at(2000), 0))
    assert history.first_effect_ns(frame(PERIOD_NS, at(2000), "ledger")) is None
    history.gone()
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(2000))) is None


def test_a_write_belongs_to_the_command_that_asked_for_it() -> None:
    history, first, newer = WriteHistory(), decided(at(1000), 15), decided(at(2000), 31)
    assert history.write(written(at(500), 1)) is None  # when the camera was opened
    history.command(first)
    history.command(newer)
    assert history.write(written(first.setting, 34)) is first
    assert history.write(written(newer.setting, 35)) is newer
    assert history.write(written(newer.setting, 36)) is None
    history, replaced = WriteHistory(), decided(at(1000), 15)
    history.command(replaced)
    history.command(newer)
    assert history.write(written(newer.setting, 32)) is newer
    assert history.write(written(replaced.setting, 40)) is None  # it never was
    history.command(replaced)
    history.gone()
    assert history.write(written(replaced.setting, 8000)) is None


def test_what_the_nodes_held_is_known_from_the_last_write_before() -> None:
    history = WriteHistory()
    assert history.held_since(5) is None
    for time_ns, time_us in ((10, 1000), (20, 2000), (30, 3000)):
        history.write(written(at(time_us), time_ns))
    assert history.held_since(9) is None  # from then to the first write they may have held anything
    assert history.held_since(25) == [at(3000), at(2000)]
    assert history.held_since(30) == [at(3000)]
    history.forget_certainty()
    assert history.held_since(40) is None
    history.write(written(at(4000), 50))
    assert history.held_since(45) is None
    assert history.held_since(55) == [at(4000)]


def test_what_a_camera_made_of_a_command_is_found_by_its_number() -> None:
    history, asked = WriteHistory(), at(1000)
    history.write(Written("left", asked, at(900), 9, 10, command=5))
    assert history.read_back(5) == at(900)
    assert history.read_back(4) is None
    assert history.has_held(at(900)) and not history.has_held(asked)
    assert history.written == [5]


def test_an_overtaken_command_does_not_claim_the_effects_of_later_equal_ones() -> None:
    history = WriteHistory()
    history.first_effect_ns(frame(0, at(1000)))
    history.command(decided(at(3000), 1))
    assert history.first_effect_ns(frame(PERIOD_NS, at(3000))) == PERIOD_NS - 1
    for setting in (at(2000), at(3000)):  # no frame is exposed between the writes
        history.command(decided(setting, PERIOD_NS + 1))
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(3000))) is None
    for number in range(90, 100):  # a second later, back and forth
        history.command(decided(at(2000 if number % 2 else 3000), number * PERIOD_NS + 1))
        delay_ns = history.first_effect_ns(frame((number + 1) * PERIOD_NS, at(2000 if number % 2 else 3000)))
        assert delay_ns == (None if number == 90 else PERIOD_NS - 1)


def test_a_slow_camera_shows_the_older_of_equal_commands() -> None:
    history = WriteHistory()
    settings = [at(1000), at(2000), at(4000), *[at(1000), at(2000)] * 5]
    delays = []
    for number in range(len(settings)):  # each frame shows what was decided four frames before
        delays.append(history.first_effect_ns(frame(number * PERIOD_NS, settings[max(number - 4, 0)])))
        history.command(decided(settings[number], number * PERIOD_NS + 1))
    assert delays[5:] == [4 * PERIOD_NS - 1] * 8


OLD, NEW = ExposureSetting(2000.0, 0.0), ExposureSetting(500.0, 6.0)
PATIENCE = PATIENCE_NS // PERIOD_NS + 1


def numbered(number: int, setting: ExposureSetting) -> Frame:
    return frame(number * PERIOD_NS, setting)


def test_a_camera_that_follows_within_half_a_second_is_not_reported() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(OLD, -1))
    history.write(written(NEW, 0))
    for number in range(PATIENCE):
        assert watch.frame(numbered(number, OLD), history) is None
    assert watch.frame(numbered(PATIENCE, NEW), history) is None
    assert watch.frames_off_setting == 0


def test_a_camera_that_does_not_follow_is_reported_until_it_does() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(OLD, -1))
    history.write(written(NEW, 0))
    reported = [watch.frame(numbered(number, OLD), history) for number in range(PATIENCE + 2 * SUSPECT_FRAMES)]
    assert reported[PATIENCE + SUSPECT_FRAMES - 2] is None
    for words in ("nodes hold 500 us, 6.0 dB", "frames are taken with 2000 us, 0.0 dB", "off and on"):
        assert words in str(reported[-1])
    assert watch.frames_off_setting == 2 * SUSPECT_FRAMES
    assert watch.frame(numbered(999, NEW), history) is None


def test_a_few_frames_with_half_of_a_setting_are_ignored() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(NEW, 0))
    half = ExposureSetting(NEW.exposure_time_us, OLD.gain_db)
    reported = [
        watch.frame(numbered(number, half if number % SUSPECT_FRAMES else NEW), history) for number in range(200)
    ]
    assert set(reported) == {None}


def test_frames_without_metadata_and_unknown_nodes_give_no_verdict() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(NEW, 0))
    inferred = [replace(numbered(number, OLD), setting_source="ledger") for number in range(100)]
    assert {watch.frame(each, history) for each in inferred} == {None}
    history.gone()
    assert {watch.frame(numbered(number, OLD), history) for number in range(100)} == {None}


def test_a_camera_that_ignores_one_write_after_another_is_reported() -> None:
    watch, history = EffectWatch(), WriteHistory()
    history.write(written(OLD, -1))
    reported = []
    for number in range(PATIENCE + 2 * SUSPECT_FRAMES):
        history.write(written(NEW, number * PERIOD_NS))
        reported.append(watch.frame(numbered(number, OLD), history))
    assert reported[PATIENCE - 2] is None
    assert "do not follow what is written" in str(reported[-1])
