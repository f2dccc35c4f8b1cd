"""Levels that served where an earlier drive saw the view change."""

from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.control.light_ahead import LightAhead
from autoexpose_daemon.control.policies.belief.foresight import Foresight
from autoexpose_daemon.control.policies.metric_map.served_before import (
    BELIEVED,
    BELIEVED_AGAIN,
    LEAST_COMPARED,
    Prospect,
    ServedBefore,
)

ROOM, WINDOW = 16.0, 9.0
NOW, FRAMES, AT = 80, 4, 83
"""The present place, the loop's delay, and where the window begins."""

LEVELS = np.arange(4.0, 20.0, 0.25)


def ahead(lit: float = 0.0, served: float = WINDOW, brighter: float = 0.0) -> LightAhead:
    """From the room to the window, where the light has risen by `lit` stops, on a day that was brighter."""
    beyond = np.arange(140) >= AT
    levels = np.where(beyond, served, ROOM) - brighter
    return LightAhead(tuple(levels.tolist()), tuple(np.where(beyond, lit, 0.0).tolist()), NOW, 1.0)


def weighed(belief: float = 0.8, places: tuple[float, ...] = (0.0, 1.0, 0.0)) -> Foresight:
    """At the present place, or one on either side of it."""
    return Foresight(belief, 0, NOW + np.arange(-1, 2), np.array(places))


def prospect(level: float, best: float, *, saturated: float = 0.4, black: float = 0.0, other: float = 0.0) -> Prospect:
    """A hill of worth 1 around the best level, and one of worth `other` around the window's."""
    worth = np.maximum(1.0 - 0.5 * np.abs(LEVELS - best), 0.0)
    return Prospect(level, saturated, black, LEVELS, np.maximum(worth, other * (1.0 - 0.5 * np.abs(LEVELS - WINDOW))))


def acquainted(level: float = ROOM, best: float = ROOM) -> ServedBefore:
    """After some frames in the room, taken with a level where another one is best."""
    memory, early = ServedBefore(), Foresight(0.8, 0, np.array([40]), np.ones(1))
    for _ in range(LEAST_COMPARED):
        series = LightAhead(ahead().levels, ahead().risen, 40, 1.0)
        assert memory.target(series, early, FRAMES, prospect(level, best)) is None
    return memory


@pytest.mark.parametrize("differs", [0.0, 1.5])
def test_it_leaps_to_the_window_before_the_frame_that_shows_it_as_today_differs(differs: float) -> None:
    seen = prospect(ROOM + differs, ROOM + differs)
    assert acquainted(ROOM + differs, ROOM + differs).target(ahead(), weighed(), FRAMES, seen) == WINDOW + differs


def test_it_does_not_leap_while_the_window_is_farther_than_the_next_frame_it_decides_on() -> None:
    assert acquainted().target(ahead(), weighed(), AT - NOW - 1, prospect(ROOM, ROOM)) is None


@pytest.mark.parametrize(
    ("series", "foresight", "seen"),
    [
        (ahead(lit=6.0), weighed(), prospect(ROOM, ROOM)),
        (ahead(), weighed(belief=BELIEVED - 0.01), prospect(ROOM, ROOM)),
        (ahead(), weighed(places=(0.05, 0.9, 0.05)), prospect(ROOM, ROOM)),
        (ahead(), weighed(), prospect(ROOM, ROOM, saturated=0.2)),
        (ahead(served=ROOM - 1.5), weighed(), prospect(ROOM, ROOM)),
    ],
    ids=["the light changes", "not believed", "place unsure", "nothing hidden", "near anyway"],
)
def test_it_leaves_the_map_alone(series: LightAhead, foresight: Foresight, seen: Prospect) -> None:
    delay = AT - NOW if foresight.places[0] else FRAMES  # so that one place in twenty is still in the room
    assert acquainted().target(series, foresight, delay, seen) is None


def test_levels_at_a_limit_of_the_camera_are_not_compared() -> None:
    limit = LEVELS.item(-1)
    assert acquainted(limit, limit).differences == []


def test_an_exposure_compensation_is_not_taken_for_a_brighter_day() -> None:
    assert acquainted(ROOM + 0.5, ROOM).differences == [0.0] * LEAST_COMPARED


def test_a_level_that_was_never_compared_is_not_followed() -> None:
    assert ServedBefore().target(ahead(), weighed(), FRAMES, prospect(ROOM, ROOM)) is None


def test_a_leap_is_held_until_its_frame_comes_and_then_judged() -> None:
    for worth, proven in ((0.7, 1), (0.3, -1)):
        memory = acquainted()
        for _ in range(FRAMES):
            assert memory.target(ahead(), weighed(), FRAMES, prospect(ROOM, ROOM)) == WINDOW
            memory.pass_frame()
        memory.target(ahead(), weighed(), FRAMES, prospect(WINDOW, ROOM, other=worth))
        assert (memory.leap, memory.proven) == (None, proven)


def test_a_leap_whose_frame_never_comes_is_forgotten() -> None:
    memory = acquainted()
    memory.target(ahead(), weighed(), FRAMES, prospect(ROOM, ROOM))
    for _ in range(FRAMES + 2):  # in which the map decides otherwise
        memory.pass_frame()
    memory.target(ahead(), weighed(belief=0.1), FRAMES, prospect(ROOM, ROOM))
    assert (memory.leap, memory.proven) == (None, 0)


def test_at_the_window_it_stays_unless_the_room_promises_twice_as_much() -> None:
    for lit, other, stays in ((0.0, 0.6, True), (0.0, 0.4, False), (6.0, 0.6, False)):
        found = acquainted().target(ahead(lit), weighed(), FRAMES, prospect(WINDOW, ROOM, other=other))
        assert found == (WINDOW if stays else None)


def test_leaps_that_were_right_count_for_more_than_belief_and_wrong_ones_ask_for_more_of_it() -> None:
    for proven, belief, leaps in ((1, 0.1, True), (-1, BELIEVED_AGAIN - 0.01, False), (-1, BELIEVED_AGAIN, True)):
        memory = acquainted()
        memory.proven = proven
        found = memory.target(ahead(), weighed(belief), FRAMES, prospect(ROOM, ROOM))
        assert (found is not None) == leaps


def test_what_one_drive_proved_says_nothing_of_another() -> None:
    memory = acquainted()
    memory.proven = 2
    memory.rest(forget=False)
    assert (len(memory.differences), memory.proven) == (LEAST_COMPARED, 2)
    memory.rest(forget=True)
    assert (memory.differences, memory.proven) == ([], 0)
