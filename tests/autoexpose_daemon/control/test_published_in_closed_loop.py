"""The policies of the other papers: each climbs its own metric, in closed loop with a delay."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.metrics.published import (
    CombinedQuality,
    SoftPercentile,
    entropy,
    entropy_weighted_gradient,
)
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.policies.published.gamma import mehta_level
from imaging.exposure import ExposureSetting

from .scene import LIMITS, LINEAR, START, expose, radiance, run

SCENE = radiance(1, 0.7)
Metric = Callable[[NDArray[np.uint8]], float]
OWN_METRIC: dict[str, Metric] = {
    "lu2010": entropy,
    "zhang2017": SoftPercentile(LINEAR).measure,
    "kim2018": entropy_weighted_gradient,
    "shin2019": CombinedQuality().measure,
    "mehta2020": GradientMetric().measure,
    "begin2022": GradientMetric().measure,
}
SEARCHES = ("lu2010", "kim2018", "shin2019")


def make(policy_id: str) -> ControlLoop:
    return ControlLoop(policy_id, LINEAR, LIMITS, START)


def view(level: float, half_scale_level: float) -> NDArray[np.uint8]:
    return ImagePreparation().prepare(expose(SCENE, ExposureSetting(2.0**level, 0.0), half_scale_level).grey8())


@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("half_scale_level", [9.0, 12.5])
@pytest.mark.parametrize("policy_id", OWN_METRIC)
def test_it_climbs_its_own_metric_within_limits(policy_id: str, half_scale_level: float, delay: int) -> None:
    def check(decision: Decision) -> None:
        assert LIMITS.contain(decision.setting)
        assert decision.setting.level == pytest.approx(decision.level, abs=1e-6)

    levels = run(make(policy_id), [half_scale_level] * 100, START, scene=SCENE, delay=delay, watch=check)
    metric = OWN_METRIC[policy_id]
    best = max(metric(view(level, half_scale_level)) for level in np.arange(6.0, 15.0, 0.25))
    assert np.ptp(levels[-20:]) < 0.02
    assert metric(view(levels[-1], half_scale_level)) > metric(view(START.level, half_scale_level))
    assert metric(view(levels[-1], half_scale_level)) > 0.84 * best


@pytest.mark.parametrize("policy_id", SEARCHES)
def test_a_search_repeats_its_question_until_the_frames_arrive(policy_id: str) -> None:
    """With a delay of 9 frames each question stays open for 9 frames; nothing is learnt from those in between."""
    decisions: list[Decision] = []
    run(make(policy_id), [11.0] * 50, START, scene=SCENE, delay=9, watch=decisions.append)
    settings = [decision.setting for decision in decisions]
    changes = [index for index in range(1, 50) if settings[index] != settings[index - 1]]
    assert changes
    assert all(later - earlier >= 9 for earlier, later in zip([0, *changes], changes, strict=False))


@pytest.mark.parametrize("policy_id", SEARCHES)
def test_a_search_rests_when_it_has_converged_and_starts_again_in_another_light(policy_id: str) -> None:
    decisions: list[Decision] = []
    levels = run(make(policy_id), [10.0] * 120 + [12.0] * 150, START, scene=SCENE, watch=decisions.append)
    assert all(decision.reason.startswith("held") for decision in decisions[100:119])
    assert np.ptp(levels[100:120]) < 1e-9
    assert any(decision.reason.startswith("query") for decision in decisions[120:150])
    assert np.ptp(levels[-20:]) < 1e-9
    assert levels[-1] - levels[119] == pytest.approx(2.0, abs=0.6)


@pytest.mark.parametrize(
    ("policy_id", "frames"), [("lu2010", 80), ("zhang2017", 240), ("shin2019", 80), ("kim2018", 80)]
)
@pytest.mark.parametrize("half_scale_level", [4.5, 18.0])
def test_it_finds_its_way_out_of_black_and_white(policy_id: str, frames: int, half_scale_level: float) -> None:
    start = ExposureSetting(7500.0, 0.0) if half_scale_level < 10 else ExposureSetting(20.0, 0.0)
    loop = ControlLoop(policy_id, LINEAR, LIMITS, start)
    levels = run(loop, [half_scale_level] * frames, start, scene=SCENE)
    assert abs(levels[-1] - half_scale_level) < 1.5


def decided(policy_id: str, light: float = 11.0, start: ExposureSetting = START) -> list[ExposureSetting]:
    decisions: list[Decision] = []
    loop = ControlLoop(policy_id, LINEAR, LIMITS, start)
    run(loop, [light] * 60, start, scene=SCENE, watch=decisions.append)
    return [decision.setting for decision in decisions]


def test_shin_chooses_the_time_itself() -> None:
    """The noiseless scene leaves the split open: its choice is set as it is, without a balance in between."""
    settings = decided("shin2019")
    assert len({round(setting.gain_db, 3) for setting in settings}) > 3
    assert len({round(setting.exposure_time_us, 1) for setting in settings}) > 3


def test_kim_keeps_the_gain_and_lu_its_proportion_to_the_time() -> None:
    kim = decided("kim2018", start=ExposureSetting(1000.0, 6.0))
    assert [setting.gain_db for setting in kim] == pytest.approx([6.0] * 60)
    ratios = [10 ** (each.gain_db / 20) / each.exposure_time_us for each in decided("lu2010", 13.0) if each.gain_db > 0]
    assert ratios == pytest.approx([ratios[0]] * len(ratios))


def test_zhang_changes_by_a_tenth_at_most() -> None:
    levels = run(make("zhang2017"), [14.0] * 60, START, scene=SCENE, delay=1)
    assert max(abs(np.diff(levels))) == pytest.approx(math.log2(1.1))


@given(st.floats(4, 19), st.floats(0.53, 1.9))
def test_mehta_brightens_above_gamma_one_by_the_law_on_ev(level: float, gamma: float) -> None:
    """Written with aperture, seconds and the decibels of Begin & Hunter's code."""
    seconds, d, kp = 2.0**level * 1e-6, 0.1, 1.6
    ev = math.log2(1.2**2 / seconds)
    r = d * math.tan((2 - gamma) * math.atan2(1, d) - math.atan2(1, d)) + 1
    ev_new = (1 + kp * (r - 1)) * ev
    new_seconds = 1.2**2 / 2**ev_new
    assert mehta_level(level, gamma) == pytest.approx(math.log2(new_seconds * 1e6), abs=1e-9)
    assert (mehta_level(level, gamma) - level) * (gamma - 1) >= 0


def test_mehta_holds_beyond_the_end_of_its_scale() -> None:
    assert mehta_level(30.0, 1.9) > 30.0


def test_kim_follows_a_light_that_its_times_cannot_reach() -> None:
    """Half scale lies at 12.9 stops with the longest time and no gain."""
    decisions: list[Decision] = []
    levels = run(make("kim2018"), [10.0] * 80 + [16.0] * 200 + [10.0] * 160, START, scene=SCENE, watch=decisions.append)
    assert abs(levels[279] - 16.0) < 1.0
    assert decisions[279].setting.exposure_time_us == pytest.approx(LIMITS.max_time_us)
    assert abs(levels[-1] - 10.0) < 1.0
    assert decisions[-1].setting.gain_db == pytest.approx(0.0)
