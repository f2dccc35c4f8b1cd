"""Which levels would have served, told by frames from before and after."""

from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.control.policies.hindsight import REACH, Hindsight, Moment
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import Frame

ROOM, WINDOW = 15.0, 8.0
"""Levels at which the middle of each has grey 64."""

FRAMES, STEP_PX, WIDTH = 70, 12, 240
HALF = 35
"""The frame of which each fills a half."""

TEXTURE = np.exp2(np.random.default_rng(7).uniform(-1.5, 1.5, (180, WIDTH + STEP_PX * FRAMES)))


def pan(levels: list[float]) -> list[Moment]:
    """What is known in the end of a pan from the room to the window, each frame taken with one of the levels."""
    hindsight = Hindsight("left", ResponseFunction.linear())
    serves = np.where(np.arange(TEXTURE.shape[1]) < STEP_PX * HALF + WIDTH // 2, ROOM, WINDOW)
    moments = []
    for number, level in enumerate(levels):
        seen = slice(STEP_PX * number, STEP_PX * number + WIDTH)
        light = 64.0 * TEXTURE[:, seen] * np.exp2(level - serves[seen])
        setting = ExposureSetting(1000.0, 20.0 * (level - np.log2(1000.0)) * np.log10(2.0))
        pixels = np.clip(np.rint(light), 0, 255).astype(np.uint8)
        moments += hindsight.see(Frame(pixels, 8, 1, 0, 0, 0, setting), float(STEP_PX))
        assert len(moments) <= max(number + 1 - REACH, 0)
    return moments + hindsight.rest()


def switch_of(moments: list[Moment]) -> int:
    """The frame from which the window's level served."""
    return next(number for number, moment in enumerate(moments) if moment.served < (ROOM + WINDOW) / 2)


@pytest.mark.parametrize("late_frames", [0, 4, 12])
def test_a_window_that_was_found_late_is_known_from_where_it_was_worth_more(late_frames: int) -> None:
    found_late = pan([ROOM] * (HALF + late_frames) + [WINDOW] * (FRAMES - HALF - late_frames))
    assert len(found_late) == FRAMES
    assert switch_of(found_late) == pytest.approx(HALF, abs=4)
    assert found_late[0].served == pytest.approx(ROOM, abs=1.5)
    assert found_late[-1].served == pytest.approx(WINDOW, abs=1.5)


def test_black_frames_say_nothing_and_keep_the_level_they_were_taken_with() -> None:
    hindsight = Hindsight("left", ResponseFunction.linear())
    black = Frame(np.zeros((180, 240), np.uint8), 8, 1, 0, 0, 0, ExposureSetting(1000.0, 0.0))
    for _ in range(3):
        hindsight.see(black, 0.0)
    assert [moment.served for moment in hindsight.rest()] == pytest.approx([np.log2(1000.0)] * 3)
    assert hindsight.rest() == []


@pytest.mark.parametrize("white", [10, 80])
def test_light_that_rose_unseen_rose_when_the_picture_went_white(white: int) -> None:
    hindsight, moments = Hindsight("left", ResponseFunction.linear()), []
    for number in range(140):
        level, serves = (14.0 if number < 20 + white else 8.0), (14.0 if number < 20 else 8.0)
        setting = ExposureSetting(1000.0, 20.0 * (level - np.log2(1000.0)) * np.log10(2.0))
        light = 64.0 * TEXTURE[:, :WIDTH] * np.exp2(level - serves)
        pixels = np.clip(np.rint(light), 0, 255).astype(np.uint8)
        moments += hindsight.see(Frame(pixels, 8, 1, 0, 0, 0, setting), 0.0)
    risen = [moment.risen for moment in moments + hindsight.rest()]
    assert risen[19] == pytest.approx(0.0, abs=0.1)
    assert risen[21:] == pytest.approx([6.0] * 119, abs=0.3)
