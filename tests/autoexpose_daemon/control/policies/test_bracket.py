"""Brackets in closed loop and virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.policies.bracket import KEPT
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.step import Override, StepInputs
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.control.scene import at_time, expose, radiance

LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
START = ExposureSetting(1000.0, 0.0)
LINEAR = ResponseFunction.linear()
SCENE = radiance(1, 1.2, (136, 180))
Light = Callable[[int], float]


def drive(
    bracketing: Bracketing, light: Light, frames: int, policy: str = "neves2009"
) -> tuple[ControlLoop, list[Decision]]:
    """What is decided on frames in a light (stops) with two frames of delay."""
    loop = ControlLoop(policy, ResponseFunction.linear(), LIMITS, START, ControlParameters(bracket=bracketing))
    settings, decisions = [START, START], []
    for number in range(frames):
        frame = expose(SCENE, settings[number], light(number))
        decisions.append(loop.step(StereoPair(number, {"left": frame})))
        settings.append(decisions[-1].setting)
    return loop, decisions


@pytest.mark.parametrize(("exposures", "range_stops"), [(6, 6.0), (4, 4.0), (5, 8.0), (2, 1.0)])
def test_a_cycle_goes_once_through_an_even_ladder(exposures: int, range_stops: float) -> None:
    _, decisions = drive(Bracketing(exposures, range_stops), lambda _: 13.0, 12 * exposures)
    last = [decision.level for decision in decisions[-exposures:]]
    assert np.allclose(np.diff(sorted(last)), range_stops / (exposures - 1))
    assert [decision.level for decision in decisions[-2 * exposures : -exposures]] == last
    neighbours = np.abs(np.diff([*last, last[0]]))
    assert neighbours.max() <= 2 * range_stops / (exposures - 1) + 1e-9  # never from one end to the other


@pytest.mark.parametrize("jump", [-9.0, -3.0, 3.0, 9.0])
def test_the_ladder_finds_the_light_again_after_a_jump(jump: float) -> None:
    """Within five cycles, as in light that was always so."""
    _, decisions = drive(Bracketing(), lambda number: 14.0 + (jump if number >= 60 else 0.0), 120)
    _, steady = drive(Bracketing(), lambda _: 14.0 + jump, 120)
    ladders = [sorted(decision.level for decision in each[-6:]) for each in (decisions[:96], steady)]
    assert np.abs(np.subtract(*ladders)).max() < 0.7


def test_the_ladder_stays_within_what_the_camera_can_do() -> None:
    for light in (-5.0, 40.0):
        _, decisions = drive(Bracketing(), lambda _, light=light: light, 60)  # type: ignore[misc]
        assert all(LIMITS.contain(decision.setting) for decision in decisions)
        assert len({round(decision.level, 6) for decision in decisions[-6:]}) == 6


def test_shots_take_gain_before_they_take_long() -> None:
    _, decisions = drive(Bracketing(), lambda _: 10.0, 60)
    for decision in decisions[-6:]:
        assert decision.setting.exposure_time_us <= 1500.0 or decision.setting.gain_db == LIMITS.max_gain_db


def test_one_frame_of_a_cycle_can_be_the_policys() -> None:
    _, decisions = drive(Bracketing(4, 4.0, keep=True), lambda _: 13.0, 100, "neves2009")
    kept = [number for number, decision in enumerate(decisions) if decision.reason.startswith(KEPT)]
    assert kept == list(range(4, 100, 5))
    alone = ControlLoop("neves2009", ResponseFunction.linear(), LIMITS, START)
    settings, levels = [START, START], []
    for number in range(40):
        decided = alone.step(StereoPair(number, {"left": expose(SCENE, settings[number], 13.0)}))
        settings.append(decided.setting)
        levels.append(decided.level)
    assert decisions[kept[-1]].level == pytest.approx(levels[-1], abs=0.1)


def test_a_snapshot_goes_on_in_the_middle_of_a_cycle() -> None:
    bracketing = Bracketing(4, 4.0, keep=True)
    loop, _ = drive(bracketing, lambda _: 13.0, 33)
    again = ControlLoop(loop.setup)
    again.restore(loop.state())
    for number in range(33, 45):
        pair = StereoPair(number, {"left": expose(SCENE, START, 13.0 + 0.1 * number)})
        assert again.step(pair) == loop.step(pair)


def test_a_snapshot_splits_the_policys_frame_as_the_original_does() -> None:
    """By the size of the frames, before the policy of the restored loop has seen one."""
    bracketing = Bracketing(4, 4.0, keep=True)
    setup = ControlSetup(DEFAULT_POLICY, {"left": LINEAR}, LIMITS, START, ControlParameters(bracket=bracketing))
    loop, again, settings = ControlLoop(setup), ControlLoop(setup), [START, START]
    for number in range(35):
        if number == 32:
            again.restore(loop.state())
        seen = at_time(expose(np.roll(SCENE, 8 * number, axis=1), settings[number], 13.0), number)
        frame = replace(seen, layout="RGGB")
        decision = loop.step(StereoPair(number, {"left": frame}))
        settings.append(decision.setting)
        if number >= 32:
            assert again.step(StereoPair(number, {"left": frame})) == decision
    assert decision.reason.startswith(KEPT)


@pytest.mark.parametrize(
    ("given", "words"),
    [((1, 6.0), "exposures is 1: give 2 to 12"), ((6, 40.0), "range_stops is 40: give 1 to 16 stops")],
)
def test_brackets_that_make_no_sense_are_refused(given: tuple[int, float], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        Bracketing(*given)


def test_the_policys_frames_follow_the_light_under_ev_compensation() -> None:
    setup = ControlParameters(bracket=Bracketing(3, 3.0, keep=True))
    loop = ControlLoop("neves2009", ResponseFunction.linear(), LIMITS, START, setup)
    settings, kept = [START, START], []
    for number in range(80):
        frame = expose(SCENE, settings[number], 13.0 if number < 20 else 16.0)
        decision = loop.step(StepInputs(StereoPair(number, {"left": frame}), override=Override(ev_stops=-1.0)))
        settings.append(decision.setting)
        if number % 4 == 3:
            kept.append(decision.level)
    assert kept[-1] - kept[4] > 2.0


@pytest.mark.parametrize("policy_id", ["zhang2017", "lu2010", "kim2018", DEFAULT_POLICY])
def test_a_compensation_comes_out_in_the_policys_frames_as_asked_for(policy_id: str) -> None:
    """Laws relative to the frame would run away with it, and searches wait for their answers for ever."""
    parameters = ControlParameters(bracket=Bracketing(2, 1.0, keep=True))
    ends = []
    for stops in (0.0, -1.0):
        loop = ControlLoop(policy_id, LINEAR, LIMITS, START, parameters)
        settings, kept = [START, START], []
        for number in range(240):
            frame = expose(SCENE, settings[number], 13.0 if number < 120 else 15.0)
            decision = loop.step(StepInputs(StereoPair(number, {"left": frame}), override=Override(ev_stops=stops)))
            settings.append(decision.setting)
            if decision.reason.startswith(KEPT):
                kept.append(decision.level)
        ends.append(kept[-1])
    assert ends[1] - ends[0] == pytest.approx(-1.0, abs=0.3 if policy_id != "kim2018" else 1.6)


def test_the_policys_frames_take_no_compensation_that_the_policy_does_not_take() -> None:
    loop = ControlLoop("begin2022", LINEAR, LIMITS, START, ControlParameters(bracket=Bracketing(keep=True)))
    loop.check_ev(-1.0)
    with pytest.raises(ConfigurationError, match="begin2022 takes no EV compensation above 0"):
        loop.check_ev(1.0)
    ControlLoop("begin2022", LINEAR, LIMITS, START, ControlParameters(bracket=Bracketing())).check_ev(1.0)
