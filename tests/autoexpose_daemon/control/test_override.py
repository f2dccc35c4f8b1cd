"""What a person asks of control stands above the policy, which neither fights it nor learns anything wrong from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.belief.policy import Belief
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from autoexpose_daemon.control.step import NO_OVERRIDE, Override, StepInputs
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

from .scene import LIMITS, at_time, expose, radiance

LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
SCENES = radiance(1, 0.8, (72, 96)), radiance(2, 0.8, (72, 96))
SHOT = ExposureSetting(100.0, 6.0)
KINDS = (
    "neves2009",
    "majer2018-full",
    "zhang2017",
    "begin2022",
    "shim2018",
    DEFAULT_POLICY,
)
"""One of each kind of law."""
SEARCHING = ("lu2010", "kim2018", "shin2019")
"""Where they end depends on the frames that they happened to try, to a stop or so."""
COMPENSATED_UP = ("fixed", "neves2009", DEFAULT_POLICY)

Ask = Callable[[int, list[Decision]], Override]


def loop_of(policy_id: str, limits: ExposureLimits = LIMITS) -> ControlLoop:
    return ControlLoop(policy_id, LINEAR, limits, START)


def run(loop: ControlLoop, lights: Sequence[float], ask: Ask, delay: int = 2) -> list[Decision]:
    """Decisions under lights (levels at which a scene is at half scale); each shows `delay` frames later."""
    settings, decisions = [START] * delay, []
    for index, light in enumerate(lights):
        left, right = (at_time(expose(scene, settings[index], light), index) for scene in SCENES)
        override = ask(index, decisions)
        decisions.append(loop.step(StepInputs(StereoPair(index, {"left": left, "right": right}), override=override)))
        settings.append(decisions[-1].setting)
    return decisions


def nothing(_index: int, _decisions: list[Decision]) -> Override:
    return NO_OVERRIDE


def ev_from(first: int, stops: float) -> Ask:
    return lambda index, _: Override(ev_stops=stops) if index >= first else NO_OVERRIDE


def rest(decisions: list[Decision]) -> float:
    """Where the last decisions are; they must not wander."""
    levels = [decision.level for decision in decisions[-20:]]
    assert np.ptp(levels) < 0.3
    return float(np.median(levels))


@pytest.mark.parametrize("policy_id", KINDS)
def test_a_compensation_downward_comes_out_as_asked_for_whatever_the_light(policy_id: str) -> None:
    lights = [11.0] * 50 + [13.0] * 80
    plain = rest(run(loop_of(policy_id), lights, nothing))
    assert rest(run(loop_of(policy_id), lights, ev_from(30, -1.0))) - plain == pytest.approx(-1.0, abs=0.3)


@pytest.mark.parametrize("policy_id", COMPENSATED_UP)
@pytest.mark.parametrize("stops", [0.5, 1.0])
def test_so_does_one_upward_where_the_policy_takes_it(policy_id: str, stops: float) -> None:
    lights = [11.0] * 50 + [13.0] * 80
    plain = rest(run(loop_of(policy_id), lights, nothing))
    decisions = run(loop_of(policy_id), lights, ev_from(30, stops))
    assert rest(decisions) - plain == pytest.approx(stops, abs=0.3)
    assert decisions[-1].reason.endswith(f"EV {stops:+g}")


def test_the_default_keeps_even_three_stops_up() -> None:
    plain = rest(run(loop_of(DEFAULT_POLICY), [11.0] * 60, nothing))
    assert rest(run(loop_of(DEFAULT_POLICY), [11.0] * 90, ev_from(30, 3.0))) - plain == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_a_policy_that_would_go_by_what_is_saturated_is_not_compensated_upward(policy_id: str) -> None:
    loop = loop_of(policy_id)
    loop.check_ev(-3.0)
    if policy_id in COMPENSATED_UP or policy_id.startswith("majer2018"):
        loop.check_ev(1.0)
    else:
        with pytest.raises(ConfigurationError, match=f"policy {policy_id} takes no EV compensation above 0"):
            loop.check_ev(0.1)


def test_a_decision_shows_the_picture_as_it_is_not_as_the_policy_is_shown_it() -> None:
    plain, dark = (run(loop_of("neves2009"), [11.0] * 60, ev_from(30, stops))[-1] for stops in (0.0, -3.0))
    assert dark.saturated_share <= plain.saturated_share
    assert dark.metric < plain.metric


def test_a_compensation_ends_at_the_limits() -> None:
    limits = ExposureLimits(20.0, 2000.0, 0.0, 0.0)
    decision = run(loop_of("fixed", limits), [11.0] * 5, ev_from(0, 3.0))[-1]
    assert (decision.setting, decision.reason) == (limits.brightest, "fixed; EV +3; held: at upper limit")


@pytest.mark.parametrize("policy_id", (*KINDS, *SEARCHING))
def test_a_held_setting_stays_and_the_policy_decides_again_afterwards_as_if_nothing_had_been(policy_id: str) -> None:
    """The light changes meanwhile."""
    lights = [11.0] * 60 + [12.0] * 110
    held = ExposureSetting(700.0, 3.0)

    def ask(index: int, _: list[Decision]) -> Override:
        return Override(held=held) if 40 <= index < 80 else NO_OVERRIDE

    decisions = run(loop_of(policy_id), lights, ask)
    assert {decision.setting for decision in decisions[40:80]} == {held}
    assert {decision.reason for decision in decisions[40:80]} == {"locked"}
    plain = run(loop_of(policy_id), lights, nothing)
    assert rest(decisions) == pytest.approx(rest(plain), abs=1.1 if policy_id in SEARCHING else 0.3)


def test_a_setting_that_is_no_longer_within_the_limits_is_held_at_the_nearest() -> None:
    limits = ExposureLimits(20.0, 500.0, 0.0, 30.0)
    held = ExposureSetting(1000.0, 0.0)
    (decision,) = run(loop_of(DEFAULT_POLICY, limits), [11.0], lambda *_: Override(held=held))
    assert limits.contain(decision.setting)
    assert decision.setting.level == pytest.approx(held.level)


@pytest.mark.parametrize(
    ("policy_id", "delay"),
    [(DEFAULT_POLICY, 1), ("neves2009", 3), *((policy_id, 2) for policy_id in (*KINDS, "kim2018"))],
)
def test_a_shot_changes_one_frame_and_no_other_decision(policy_id: str, delay: int) -> None:
    taken = 50

    def ask(index: int, decisions: list[Decision]) -> Override:
        if index == taken:
            return Override(shot=SHOT)
        if index == taken + delay:
            former = decisions[-1 if delay > 1 else -2].setting
            return Override(held=former, unseen=True)
        return NO_OVERRIDE

    plain = run(loop_of(policy_id), [11.0] * 65, nothing, delay)
    decisions = run(loop_of(policy_id), [11.0] * 65, ask, delay)
    assert (decisions[taken].setting, decisions[taken].reason) == (SHOT, "one shot")
    apart = [abs(one.level - other.level) for one, other in zip(decisions, plain, strict=True)]
    assert max(apart[:taken] + apart[taken + 1 :]) < (1.0 if policy_id in SEARCHING else 0.3)


@pytest.mark.parametrize("policy_id", (*KINDS, *SEARCHING))
def test_a_shot_is_over_even_if_the_next_frame_of_a_camera_is_lost(policy_id: str) -> None:
    loop = loop_of(policy_id)
    before = run(loop, [11.0] * 100, nothing)[-1]
    left, right = (at_time(expose(scene, before.setting, 11.0), 100) for scene in SCENES)
    loop.step(StepInputs(StereoPair(100, {"left": left, "right": right}), override=Override(shot=SHOT)))
    assert loop.step(StereoPair(101, {"right": right})).level == pytest.approx(before.level, abs=0.5)


@pytest.mark.parametrize("delay", [1, 3])
def test_the_delay_of_the_loop_is_learnt_as_without_requests(delay: int) -> None:
    def ask(index: int, decisions: list[Decision]) -> Override:
        if 20 <= index < 40:
            return Override(held=decisions[19].setting)
        if 60 <= index < 90:
            return Override(ev_stops=1.0)
        return NO_OVERRIDE

    loop = loop_of("belief")
    run(loop, [11.0] * 30 + [12.0] * 40 + [11.0] * 50, ask, delay)
    assert isinstance(loop._policy, Belief)
    assert loop._policy.latency.frames == delay


@pytest.mark.parametrize("stops", [-0.5, -1.0])
def test_a_compensation_downward_is_steady_where_the_limits_leave_it_dark(stops: float) -> None:
    """Dark with the compensation, and just not dark without it."""
    decisions = run(loop_of(DEFAULT_POLICY), [22.5] * 60, ev_from(0, stops))
    assert {decision.level for decision in decisions[-20:]} == {LIMITS.brightest.level + stops}
