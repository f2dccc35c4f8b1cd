"""Writes, and what frames show of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.rig.events import Written
from drivers.triggers.rate import TriggerGrid
from drivers.triggers.writes import EFFECT_TRIGGERS, Command, RigWrites
from imaging.exposure import ExposureSetting
from imaging.frames import SIDES, Frame, Side, StereoPair

MS = 1_000_000
GRID = TriggerGrid(20 * MS, 0)
DIM, BRIGHT = ExposureSetting(1000.0, 0.0), ExposureSetting(4000.0, 6.0)


def wrote(side: Side, setting: ExposureSetting, start_ms: int, end_ms: int) -> Written:
    return Written(side, setting, setting, start_ms * MS, end_ms * MS, command=id(setting))


def pair(trigger: int, left: ExposureSetting, right: ExposureSetting, taken_ms: int = 0) -> StereoPair:
    black = np.zeros((2, 2), np.uint8)
    settings = zip(SIDES, (left, right), strict=True)
    return StereoPair(trigger, {side: Frame(black, 8, 0, 0, taken_ms * MS, 0, setting) for side, setting in settings})


def test_a_write_between_two_exposures_is_in_time() -> None:
    writes = RigWrites(SIDES)
    writes.write(wrote("left", BRIGHT, 1, 500), None)  # before the first frame nothing is late
    writes.write(wrote("left", DIM, 1, 3), GRID)
    writes.write(wrote("right", DIM, 2, 19), GRID)
    assert writes.late == 0
    assert not writes.mismatched(pair(1, DIM, DIM))
    assert not writes.explains(pair(1, DIM, BRIGHT))


@pytest.mark.parametrize("spans", [((1, 21), (1, 3)), ((1, 3), (19, 21)), ((1, 3), (21, 23)), ((1, 21), (1, 23))])
def test_a_setting_that_an_exposure_cuts_in_two_is_late_once(spans: tuple[tuple[int, int], tuple[int, int]]) -> None:
    writes = RigWrites(SIDES)
    writes.write(wrote("left", DIM, *spans[0]), GRID)
    writes.write(wrote("right", DIM, *spans[1]), GRID)
    assert writes.late == 1
    assert writes.explains(pair(1, BRIGHT, DIM))
    assert not writes.explains(pair(1 + EFFECT_TRIGGERS + 1, BRIGHT, DIM))


def both_written() -> RigWrites:
    writes = RigWrites(SIDES)
    for side in ("left", "right"):
        writes.write(wrote(side, BRIGHT, -19, -18), GRID)
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
    for side in SIDES:
        writes.write(wrote(side, DIM, 25, 36), GRID)
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
    for side in SIDES:
        writes.write(wrote(side, newer, 21, 23), GRID)
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
    writes = RigWrites(SIDES)
    for side in ("left", "right"):
        writes.write(wrote(side, DIM, 1, 2), GRID)
        writes.write(wrote(side, BRIGHT, 3, 4), GRID)
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
