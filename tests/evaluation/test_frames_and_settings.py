"""Each frame is judged by the setting it was taken with, and each pose by the moment it belongs to."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from evaluation.arena.race import run_course
from evaluation.arrays import Greys
from evaluation.odometry.stereo import Tracked, prepared
from evaluation.odometry.tracking import TrackedRun, odometry_stage, track_entrants
from evaluation.scenes.scenarios import Course
from evaluation.stage.camera import Entrant
from evaluation.stage.rendering import Stage
from fake_camera.world.sensor import DEFAULT_F_NUMBER
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting
from imaging.frames import StereoPair

START = ExposureSetting(500.0, 20.0)
FIRST_S = 3.0
"""At full speed; the lap begins at rest."""


class Watched:
    """A control loop that records its decisions."""

    def __init__(self, loop: ControlLoop) -> None:
        self._loop = loop
        self.setup, self.balance, self.objective = loop.setup, loop.balance, loop.objective
        self.decisions: list[Decision] = []

    def step(self, pair: StereoPair) -> Decision:
        self.decisions.append(self._loop.step(pair))
        return self.decisions[-1]


@pytest.mark.parametrize("delay", [1, 3])
def test_the_arena_judges_the_frame_that_the_policy_saw(delay: int) -> None:
    """Not a frame taken with the setting just decided, which takes effect `delay` frames later."""
    loops: list[Watched] = []

    def make(*setup: object) -> Watched:
        loops.append(Watched(ControlLoop("begin2022", *setup)))
        return loops[-1]

    (series,) = run_course("step_down", "leaves", 3, [Entrant("watched", delay, make)], frames=38)
    assert np.ptp(series.levels) > 1.0
    assert series.metrics[:, 0] == pytest.approx([decision.metric for decision in loops[0].decisions])


class Ladder:
    """Decides on a new exposure time at every frame: 1000 us at the first, 1020 us at the second, and so on."""

    def __init__(self, *_setup: object) -> None:
        self.setup = SimpleNamespace(start=START)
        self._seen = 0

    def step(self, _pair: StereoPair) -> SimpleNamespace:
        self._seen += 1
        return SimpleNamespace(setting=ExposureSetting(980.0 + 20.0 * self._seen, 20.0), metric=0.1)


class Nowhere:
    """Odometry that sees nothing."""

    def track(self, _left: Greys, _right: Greys) -> Tracked:
        return Tracked(np.eye(4), lost=True)


def driven(delays: tuple[int, ...], frames: int) -> tuple[Stage, list[TrackedRun], list[list[StereoPair]]]:
    """The stage, the runs of entrants with these delays, and the pairs that odometry got of each."""
    views, light = (stage := odometry_stage("even", 1, 0, 0)).views, stage.light
    times_s = FIRST_S + np.arange(frames) / 60.0
    stage = Stage(views, Course(light, lambda _: 0.0, 0), 0, times_s)
    shown: list[list[StereoPair]] = [[] for _ in delays]
    entrants = [Entrant(f"delay {delay}", delay, Ladder) for delay in delays]
    runs = track_entrants(stage, entrants, Nowhere, frames, lambda entrant, pair: shown[entrant].append(pair))
    return stage, runs, shown


def test_odometry_gets_pairs_taken_with_decisions_of_d_frames_ago_and_the_poses_in_their_middle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("evaluation.odometry.tracking.best_start", lambda _: START)  # slow, and not under test here
    stage, runs, shown = driven((1, 3), 8)
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    for one, pairs in zip(runs, shown, strict=True):
        delay = one.entrant.delay_frames
        assert [pair.frames["left"].frame_id for pair in pairs] == [0, 2, 4, 6]
        for pair, pose in zip(pairs, one.truth, strict=True):
            decided_on = pair.frames["left"].frame_id - delay
            time_us = 500.0 if decided_on < 0 else 1000.0 + 20.0 * decided_on
            assert pair.frames["left"].setting == pair.frames["right"].setting == ExposureSetting(time_us, 20.0)
            middle_s = FIRST_S + pair.frames["left"].frame_id / 60.0 + time_us / 2e6
            assert np.allclose(pose, view.pose(middle_s), atol=1e-6)  # it moves by 1.4 mm in a frame


def test_a_course_behind_half_the_aperture_is_two_stops_darker() -> None:
    usual, slow = (odometry_stage("low", 1, 0, 0, f_number) for f_number in (DEFAULT_F_NUMBER, 2 * DEFAULT_F_NUMBER))
    image = usual.expose("left", ExposureSetting(1000.0, 20.0)).astype(float)
    again = slow.expose("left", ExposureSetting(1000.0, 20.0 + 12.04)).astype(float)
    assert slow.expose("left", ExposureSetting(1000.0, 20.0)).mean() < 0.3 * image.mean()
    assert again.mean() == pytest.approx(image.mean(), rel=0.02)
    assert np.abs(again - image).mean() > 1.0  # with fewer electrons, more noise


def test_odometry_sees_into_the_dark_as_the_paper_does() -> None:
    """With a gamma of 0.3, 1 % of full scale becomes a quarter of it."""
    for grey, seen in ((0, 0), (3, 67), (26, 129), (128, 207), (255, 255)):
        assert np.unique(prepared(np.full((5, 5), grey, np.uint8))).tolist() == [seen]
    hot = np.full((5, 5), 26, np.uint8)
    hot[2, 2] = 255
    assert prepared(hot)[2, 2] == 129
