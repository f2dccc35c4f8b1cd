"""Policy `mehta2020`: Shim's law in the form of Mehta et al. 2020, tuned as Begin & Hunter 2022 compared with it."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.polynomial import polynomial

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policies.published.gamma_step import exposure_value, relative_step
from autoexpose_daemon.control.policies.published.shim2018 import gamma_table
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, PolicySetup, Target
from autoexpose_daemon.control.search.optimum import PolynomialFit, best_sample
from autoexpose_daemon.control.search.predicted_curve import PredictedCurve

GAMMAS = (1 / 1.9, 1 / 1.5, 1 / 1.2, 1.0, 1.2, 1.5, 1.9)
"""Anchors of Mehta's code, which raises grey levels to 1/gamma: above 1 a picture brightens, unlike in eq. (15)."""

DEGREE = 5


def next_level(level: float, gamma: float) -> float:
    """The exposure level (stops) that follows from gamma* by eq. (17) and (18), on exposure value.

    Exposure value falls as exposure rises, and gamma is the inverse of eq. (15)'s: the two invert the law twice. There is
    no alpha of eq. (19): Mehta's code has it commented out, on the branch that darkens, and Begin & Hunter's lacks it.
    """
    return level - relative_step(gamma) * exposure_value(level)


class Mehta2020(ExposurePolicy):
    """Gamma* from the roots of the fitted polynomial's derivative, and the step of `next_level`. No state.

    Read in ishaanmht/aer_auto_exposure_gradient, `src/auto_exp.cpp` (the paper was not at hand): anchors, degree,
    the law on exposure value. A root counts between the outer anchors and when the polynomial there exceeds the
    best anchor, else the best anchor is taken. k_p and the aperture are Begin & Hunter's, see `gamma_step`. Our own: the
    metric is `GradientMetric` (their gradient loses negative slopes), every frame is used (theirs skips every other
    one), and an image of equal gradient under every gamma holds (theirs darkens). `mehta2020-code` is the law as Begin &
    Hunter's code runs it.
    """

    FLOW = "farneback"

    def __init__(self, metric: GradientMetric, balance: Balance) -> None:
        self.balance = balance
        self._fit = PolynomialFit(GAMMAS, DEGREE)
        self._curve = PredictedCurve(metric, np.stack([gamma_table(1 / gamma) for gamma in GAMMAS]), GAMMAS.index(1.0))

    @classmethod
    def build(cls, setup: PolicySetup) -> Self:
        """With the balance of section 3.3 of Begin & Hunter 2022, unless another is configured."""
        return cls(setup.metric, setup.balance())

    def decide(self, observation: Observation) -> Target:
        """The law's step from the level of this frame."""
        metrics = self._curve.measure(observation)
        level = observation.setting.level
        if np.ptp(metrics) == 0:
            return Target(level, "held: no gradient under any gamma")
        best = best_sample(self._fit.positions, metrics, origin=1.0)
        coefficients = self._fit.coefficients(metrics)
        roots = np.asarray(polynomial.polyroots(polynomial.polytrim(polynomial.polyder(coefficients), 1e-12)))
        real = roots.real[(abs(roots.imag) < 1e-9) & (roots.real > GAMMAS[0]) & (roots.real < GAMMAS[-1])]
        gamma, value = best.position, best.value
        for root in real:
            if (height := float(polynomial.polyval(root, coefficients))) > value:
                gamma, value = float(root), height
        target = next_level(level, gamma)
        if abs(target - level) < 1e-9:
            return Target(level, "held: metric at its maximum")
        return Target(target, f"gamma* {gamma:.2f} {'brightens' if gamma > 1 else 'darkens'}")
