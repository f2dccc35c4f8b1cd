from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policies.published.begin2022 import EPSILON, gain_ratio
from autoexpose_daemon.control.policies.published.gamma import MEHTA_GAMMAS, gamma_table, mehta_level, next_level
from autoexpose_daemon.control.policy import ExposurePolicy, Look, Observation, PastStep, Target
from autoexpose_daemon.control.search import way_out
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import SIDES, Side
from imaging.response import ResponseFunction

from .scene import LIMITS, NOTHING_GIVEN, expose, policy_of, radiance

LINEAR = ResponseFunction.linear()
SETTING = ExposureSetting(1000.0, 6.0)


def observe(image: NDArray[np.uint8], realised: PastStep | None = None) -> Observation:
    metric = GradientMetric().measure(image)
    looks = [Look("left", image, LINEAR)]
    return Observation(looks, SETTING, metric, 0.0, 0.0, 0.0, LIMITS, NOTHING_GIVEN, [realised] if realised else [])


def flat(grey: int) -> NDArray[np.uint8]:
    return np.full((68, 90), grey, np.uint8)


def view(stops_from_half_scale: float, seed: int = 0) -> NDArray[np.uint8]:
    frame = expose(radiance(seed, 0.5), SETTING, SETTING.level - stops_from_half_scale)
    return frame.grey8()


def shim() -> ExposurePolicy:
    return policy_of("shim2018")


def begin() -> ExposurePolicy:
    return policy_of("begin2022")


def test_gamma_follows_equation_15() -> None:
    assert [int(gamma_table(0.5)[i]) for i in (0, 64, 255)] == [0, round(255 * math.sqrt(64 / 255)), 255]
    assert np.array_equal(gamma_table(1.0), np.arange(256))


@given(st.floats(4, 20), st.floats(0.1, 1.9))
def test_shim_steps_towards_brightness_below_gamma_one(level: float, gamma: float) -> None:
    r = 0.1 * math.tan(math.atan(10) * (1 - gamma)) + 1
    exposure_value = math.log2(2.8**2 / (2.0**level * 1e-6))
    assert next_level(level, gamma) - level == pytest.approx((0.2 if gamma >= 1 else 0.4) * (r - 1) * exposure_value)
    assert (next_level(level, gamma) - level) * (1 - gamma) >= 0
    assert next_level(level, 1.0) == level


def test_shim_brightens_the_dark_and_darkens_the_bright() -> None:
    assert shim().decide(observe(view(-4))).level > SETTING.level
    assert shim().decide(observe(view(+2))).level < SETTING.level


@pytest.mark.parametrize("grey", [0, 90, 255])
def test_without_gradient_it_does_not_move(grey: int) -> None:
    for policy in (shim(), begin()):
        target = policy.decide(observe(flat(grey)))
        assert target.level == SETTING.level
        assert target.reason.startswith("held: no gradient")


def test_begin_moves_towards_the_metric() -> None:
    assert begin().decide(observe(view(-3))).level > SETTING.level
    assert begin().decide(observe(view(+1.5))).level < SETTING.level


def test_begin_never_moves_further_than_predicted_times_factor() -> None:
    for stops in np.linspace(-6, 4, 21):
        assert abs(begin().decide(observe(view(stops))).level - SETTING.level) <= 2.0


def test_feedback_follows_equations_21_and_22() -> None:
    image = view(-3)
    plain = begin().decide(observe(image)).level - SETTING.level
    metric = observe(image).metric

    def promised(past_metric: float, predicted: float | None) -> Observation:
        return observe(image, PastStep(SETTING, 0.0, past_metric, Target(SETTING.level, "", predicted)))

    # promised half of what came: r close to 2
    better = promised(metric - 0.02, metric - 0.01)
    assert gain_ratio(better) == pytest.approx(0.02 / (0.01 + EPSILON))
    assert begin().decide(better).level - SETTING.level == pytest.approx(1.5 * plain)
    for other in (promised(metric - 0.02, metric), promised(metric - 0.02, metric + 0.1), promised(0.0, None)):
        assert begin().decide(other).level - SETTING.level == pytest.approx(plain)


def test_epsilon_is_the_papers_in_our_scale() -> None:
    assert pytest.approx(4.03e-4, rel=2e-3) == EPSILON


def test_begin_predicts_the_metric_at_its_target() -> None:
    target = begin().decide(observe(view(-1)))
    taken = GradientMetric().measure(view(-1 + target.level - SETTING.level))
    assert target.predicted_metric == pytest.approx(taken, rel=0.1)


def test_neves_moves_by_the_error_of_the_mean() -> None:
    policy = policy_of("neves2009")
    assert policy.decide(observe(flat(51))).level == SETTING.level
    # one stop too dark: integral 0.6 plus proportional 0.15 of the change from 0
    assert policy.decide(observe(flat(51 // 2))).level - SETTING.level == pytest.approx(0.75, abs=0.03)
    assert policy.decide(observe(flat(51 // 2))).level - SETTING.level == pytest.approx(0.6, abs=0.03)


def test_majer_follows_equation_1_every_five_frames() -> None:
    policy = policy_of("majer2018-full")
    image = flat(64)
    targets = [policy.decide(observe(image)).level for _ in range(5)]
    factor = 1 + 0.9 * (0.5 / (64 / 255) - 1)
    assert targets == [SETTING.level + math.log2(factor)] * 5
    assert policy.decide(observe(flat(250))).level < SETTING.level


def test_majer_standard_looks_at_the_top_half() -> None:
    image = flat(10)
    image[34:] = 250
    assert policy_of("majer2018-standard").decide(observe(image)).level > SETTING.level
    image = image[::-1].copy()
    assert policy_of("majer2018-standard").decide(observe(image)).level < SETTING.level


@pytest.mark.parametrize("side", SIDES)
def test_majer_refuses_a_region_below_the_top_half_of_either_camera_at_once(side: Side) -> None:
    """Not only when the first frame of the other camera is lost."""
    weights = np.zeros((68, 90), np.uint8)
    weights[60:] = 1
    looks = [Look(each, flat(64), LINEAR, weights if each == side else None) for each in SIDES]
    observation = replace(observe(flat(64)), looks=looks)
    with pytest.raises(ConfigurationError, match=f"leaves nothing of the top half of the {side} image"):
        policy_of("majer2018-standard").decide(observation)


@pytest.mark.parametrize("stops", [-1.5, 0.25, 2.75])
def test_mehta_takes_the_highest_point_of_the_polynomial_between_the_outer_anchors(stops: float) -> None:
    image = view(stops)
    brightened = [GradientMetric().measure(gamma_table(1 / gamma)[image]) for gamma in MEHTA_GAMMAS]
    grid = np.linspace(MEHTA_GAMMAS[0], MEHTA_GAMMAS[-1], 20_001)
    best = grid[np.polyval(np.polyfit(MEHTA_GAMMAS, brightened, 5), grid).argmax()]
    target = policy_of("mehta2020").decide(observe(image))
    assert not min(abs(best - gamma) for gamma in MEHTA_GAMMAS) < 0.01
    assert target.level == pytest.approx(mehta_level(SETTING.level, best), abs=1e-3)


@pytest.mark.parametrize(
    ("black", "saturated", "stops"), [(0.9, 0.0, 0), (0.0, 0.9, 0), (0.97, 0.0, 2), (0.0, 0.97, -2)]
)
def test_a_search_gives_up_only_on_frames_that_show_nothing(black: float, saturated: float, stops: int) -> None:
    way = way_out(replace(observe(view(0)), black_share=black, saturated_share=saturated))
    assert (0 if way is None else way.level - SETTING.level) == stops


@pytest.mark.parametrize(("stops", "brighter"), [(-1.5, True), (1.5, False)])
def test_lu_looks_first_where_the_middle_of_the_scale_lies(stops: float, brighter: bool) -> None:
    image = view(stops)
    assert (image.mean() < 127) == brighter
    assert (policy_of("lu2010").decide(observe(image)).level > SETTING.level) == brighter


def test_ids_are_known_without_loading_the_policies() -> None:
    code = "import sys, autoexpose_daemon.cli; print('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "False\n"
