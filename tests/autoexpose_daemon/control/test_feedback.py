"""What `begin2022` predicts, and with which of its predictions a frame is compared."""

from __future__ import annotations

import pytest
from numpy.polynomial import Polynomial

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policy import Look, Observation
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction, prediction_tables

from .scene import LIMITS, NOTHING_GIVEN, at_time, expose, policy_of, radiance

LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
SAMPLES = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)


@pytest.mark.parametrize("stops_too_bright", [1.0, 1.5])
def test_the_prediction_is_the_maximum_of_the_polynomial_not_the_best_sample(stops_too_bright: float) -> None:
    """Algorithm 1, step 2, by numpy: the maximum lies between two samples, and above both."""
    image = expose(radiance(1, 0.5), START, START.level - stops_too_bright).grey8()
    samples = [GradientMetric().measure(table[image]) for table in prediction_tables(LINEAR, SAMPLES)]
    through = Polynomial.fit(SAMPLES, samples, 6)
    peaks = [root.real for root in through.deriv().roots() if abs(root.imag) < 1e-9]
    peak = min((place for place in peaks if through.deriv(2)(place) < 0), key=abs)

    seen = Observation([Look("left", image, LINEAR)], START, samples[3], 0.0, 0.0, 0.0, LIMITS, NOTHING_GIVEN)
    target = policy_of("begin2022").decide(seen)
    assert target.level - START.level == pytest.approx(peak, abs=1e-3)
    assert target.predicted_metric == pytest.approx(through(peak), rel=1e-3)
    assert target.predicted_metric > 1.03 * max(samples)


def reason_at(lights: list[float], then: float) -> str:
    """The reason given for a frame under the last light; the same decision was made under each light before."""
    limits = ExposureLimits(20.0, 2000.0, 0.0, 0.0)  # so narrow that any darkness leads to the same
    loop = ControlLoop("begin2022", LINEAR, limits, START)
    scene, setting = radiance(3, 0.7), START
    decisions = []
    for index, light in enumerate([*lights, then]):
        setting = START if index < len(lights) else limits.brightest
        decisions.append(loop.step(StereoPair(index, {"left": at_time(expose(scene, setting, light), index)})))
    assert {decision.setting for decision in decisions} == {limits.brightest}
    return decisions[-1].reason


def test_a_frame_is_compared_with_the_latest_decision_it_may_realise() -> None:
    """Not with one made in the dark before: light switched on since is not a success of the exposure."""
    assert "more than predicted" not in reason_at([13.0], then=13.0)
    assert "more than predicted" in reason_at([15.0], then=13.0)
    assert "more than predicted" not in reason_at([15.0, 13.0], then=13.0)
