"""What a decision is said to rest on: it is what the policy has, and saying it changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision, Grounds, SceneHistogram
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.belief.scene_belief import DARK_DN
from imaging.exposure import ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

from .scene import LIMITS, at_time, expose, radiance, run

LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
HALF_SCALE = 10.0
WINDOW = radiance(1, 0.5)
WINDOW[:, 100:] *= 2.0**6
RAMP = np.tile(np.exp2(np.linspace(-5.0, 3.0, WINDOW.shape[1])), (WINDOW.shape[0], 1))
"""From dark to bright, without edges, at which pixels are mixtures."""


def loop_of(policy_id: str = "belief") -> ControlLoop:
    return ControlLoop(policy_id, LINEAR, LIMITS, START)


def asked(loop: ControlLoop) -> Grounds:
    grounds = loop.grounds
    assert grounds is not None
    return grounds


def seen_once(setting: ExposureSetting) -> tuple[SceneHistogram, NDArray[np.generic]]:
    """What a frame of the ramp leaves, and its pixels."""
    loop, frame = loop_of(), at_time(expose(RAMP, setting, HALF_SCALE), 0)
    loop.step(StereoPair(0, {"left": frame, "right": frame}))
    return asked(loop).scenes["left"], frame.pixels


def middles(scene: SceneHistogram) -> NDArray[np.float64]:
    return scene.start + scene.bin_stops * (np.arange(len(scene.known)) + 0.5)


@pytest.mark.parametrize("time_us", [30.0, 300.0, 1000.0, 7000.0])
def test_what_is_known_and_guessed_is_the_whole_picture(time_us: float) -> None:
    scene, grey = seen_once(ExposureSetting(time_us, 0.0))
    clipped = np.mean((grey <= DARK_DN) | (grey == 255))
    assert sum(scene.known) + sum(scene.guessed) == pytest.approx(1.0, abs=0.05)
    assert sum(scene.guessed) == pytest.approx(clipped, abs=0.05)
    assert sum(scene.contrast) == pytest.approx(1.0, abs=1e-3)
    assert len(scene.known) == len(scene.guessed) == len(scene.contrast)


def test_a_frame_is_white_from_its_level_on_and_knows_what_lies_below() -> None:
    """Its grey levels tell the same: a pixel at half scale lies one stop below white."""
    setting = ExposureSetting(1000.0, 6.0)
    scene, grey = seen_once(setting)
    assert scene.white == pytest.approx(-setting.level, abs=0.05)
    assert 6.0 < scene.white - scene.black < 9.0
    known, places = np.array(scene.known), middles(scene)
    inside = (places > scene.black - scene.bin_stops) & (places < scene.white + scene.bin_stops)
    assert known[inside].sum() == pytest.approx(known.sum())
    bright = places > scene.white - 1.0
    assert known[bright].sum() == pytest.approx(np.mean((grey > 127) & (grey < 255)), abs=0.05)
    beyond = np.array(scene.guessed)[places > scene.white].sum()
    assert beyond == pytest.approx(np.mean(grey == 255), abs=0.05)


def test_frames_of_several_exposures_together_know_the_light_of_the_scene() -> None:
    """As its painter knows it: the distribution of log radiance over the picture."""
    loop = loop_of()
    for index, time_us in enumerate([30.0, 400.0, 6000.0]):
        frame = at_time(expose(RAMP, ExposureSetting(time_us, 0.0), HALF_SCALE), index)
        loop.step(StereoPair(index, {"left": frame, "right": frame}))
    scene = asked(loop).scenes["left"]
    painted = np.log2(RAMP / 2.0) - HALF_SCALE
    below = middles(scene) + scene.bin_stops / 2
    shares = [np.mean(painted < bound) for bound in below]
    assert np.cumsum(scene.known) == pytest.approx(shares, abs=0.05)


def test_what_is_decided_is_the_best_of_the_values_and_a_look_fills_the_histogram() -> None:
    loop = loop_of()
    guessed: list[float] = []

    def watch(decision: Decision) -> None:
        grounds = asked(loop)
        assert grounds.best_level == pytest.approx(decision.level)
        assert max(grounds.value) == grounds.value[grounds.levels.index(grounds.best_level)]
        assert 0.0 <= min(grounds.worth) <= max(grounds.worth) <= 1.0 + 1e-9
        guessed.append(sum(grounds.scenes["left"].guessed))

    levels = run(loop, [HALF_SCALE] * 12, ExposureSetting(2000.0, 0.0), scene=WINDOW, watch=watch)
    assert guessed[0] > 0.4
    assert guessed[-1] < 0.1
    assert min(levels) < levels[0] - 2.0
    assert asked(loop).level == levels[-1]


def test_asking_changes_no_decision() -> None:
    lights = [*[HALF_SCALE] * 6, *[HALF_SCALE + 4.0] * 6]
    quiet, watched = loop_of(), loop_of()
    alone = run(quiet, lights, START, scene=WINDOW)
    assert run(watched, lights, START, scene=WINDOW, watch=lambda _: watched.grounds and None) == alone


def test_other_policies_have_none_and_the_belief_none_before_its_first_decision() -> None:
    loop = loop_of("neves2009")
    run(loop, [HALF_SCALE], START)
    assert loop.grounds is None
    assert loop_of().grounds is None
