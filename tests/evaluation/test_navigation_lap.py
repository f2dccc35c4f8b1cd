"""A robot steers itself back to a taught path through a simulated park."""

import math

import numpy as np
import pytest

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.navigation.laps import LapRepeater, Taught, Wanderer, taught
from evaluation.experiments.teach.park import ParkPath
from navigation.drive.repetition import Stop
from navigation.maps.path import Velocity

SEED = 31
LENGTH_M = 3.0


@pytest.fixture(scope="module")
def lesson() -> Taught:
    """In a park with coarser ground and fewer kinds of shrubs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evaluation.experiments.teach.park.MEADOW_TEXELS", 1024)
        patch.setattr("evaluation.experiments.teach.park.HEDGES", 2)
        return taught(ParkPath(SEED, 12.0), SEED, DEFAULT_POLICY, LENGTH_M)


def test_a_lesson_has_a_local_map_every_0_2_m(lesson: Taught) -> None:
    distances_m = np.array([place.distance_m for place in lesson.places])
    assert np.diff(distances_m) == pytest.approx(0.2, abs=0.041) and len(distances_m) >= 15
    assert lesson.speeds.length_m == LENGTH_M


def test_a_robot_that_starts_aside_and_turned_comes_closer_and_to_the_end(lesson: Taught) -> None:
    robot = LapRepeater(lesson, "as taught", DEFAULT_POLICY, aside_m=0.3, turned_rad=math.radians(5.0))
    lap = robot.lap()
    assert lap.completed and lap.registered.mean() > 0.9
    assert lap.aside_m[0] == pytest.approx(0.3, abs=0.02)
    assert lap.aside_m[-1] < lap.aside_m.max() - 0.03


def test_without_what_it_sees_a_robot_stops_within_two_metres(lesson: Taught) -> None:
    robot = LapRepeater(lesson, "as taught", DEFAULT_POLICY, aside_m=0.0, turned_rad=math.pi)  # it looks the other way
    lap = robot.lap()
    assert lap.stop is Stop.LOST and not lap.completed


def test_a_wanderer_errs_as_its_odometry_does() -> None:
    robot = Wanderer(np.zeros(2), 0.0, seed=1)
    for _ in range(100):
        robot.drive(Velocity(0.4, 0.0))
    assert abs(robot.driven_m - 4.0) == pytest.approx(0.08)
    assert abs(robot.heading_rad) == pytest.approx(math.radians(4.0))
