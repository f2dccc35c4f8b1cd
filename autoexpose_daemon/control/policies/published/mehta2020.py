"""Policy `mehta2020`: Shim's law in the form of Mehta et al. 2020, tuned as in Begin & Hunter 2022's comparison."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policies.published.shim2018 import GammaStep, gamma_table
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.search.optimum import PolynomialFit
from autoexpose_daemon.control.search.query import PredictedCurve
from autoexpose_daemon.control.setup import ControlSetup
from imaging.python310 import Self

GAMMAS = (1 / 1.9, 1 / 1.5, 1 / 1.2, 1.0, 1.2, 1.5, 1.9)
"""Anchors of Mehta's code, which raises grey levels to 1/gamma: above 1 a picture brightens, unlike in eq. (15)."""

DEGREE = 5

STEP = GammaStep(proportional_gain=1.6, aperture=1.2)
"""As Begin & Hunter set them for their comparison (section 3.3; `vo_autoexpose.h`, `vo_autoexpose_node.cpp`). Mehta's
own code has f/2.8 and a k_p of 0.2 to 0.4."""


def next_level(level: float, gamma: float) -> float:
    """The exposure level (stops) that follows from gamma* by eq. (17) and (18), on exposure value.

    Exposure value falls as exposure rises, and gamma is the inverse of eq. (15)'s: the two invert the law twice. There
    is no alpha of eq. (19): Mehta's code has it commented out, on the branch that darkens; Begin & Hunter's has none.
    """
    return level - STEP.change(level, gamma)


class Mehta2020(ExposurePolicy):
    """Gamma* from the roots of the fitted polynomial's derivative, and the step of `next_level`. No state.

    Read in ishaanmht/aer_auto_exposure_gradient, `src/auto_exp.cpp` (the paper was not at hand): anchors, degree, the
    law on exposure value. A root counts if it lies between the outer anchors and the polynomial there exceeds the best
    anchor; else the best anchor is taken, the first among equals: an image without gradient under any gamma darkens, so
    white is left, but black is not. Our own: the metric is `GradientMetric` (their gradient loses negative slopes) and
    every frame is used (theirs skips every other one). `mehta2020-code` is the law as Begin & Hunter's code runs it.
    """

    FLOW = "farneback"

    def __init__(self, metric: GradientMetric, balance: Balance) -> None:
        self.balance = balance
        self._fit = PolynomialFit(GAMMAS, DEGREE)
        self._curve = PredictedCurve(metric, np.stack([gamma_table(1 / gamma) for gamma in GAMMAS]), GAMMAS.index(1.0))

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With the balance of section 3.3 of Begin & Hunter 2022, unless another is configured."""
        return cls(setup.metric, setup.balance())

    def decide(self, observation: Observation) -> Target:
        """The law's step from the level of this frame."""
        metrics = self._curve.measure(observation)
        level = observation.setting.level
        first_best = int(np.argmax(metrics))
        coefficients = self._fit.coefficients(metrics)
        roots = np.asarray(polynomial.polyroots(polynomial.polytrim(polynomial.polyder(coefficients), 1e-12)))
        real = roots.real[(abs(roots.imag) < 1e-9) & (roots.real > GAMMAS[0]) & (roots.real < GAMMAS[-1])]
        gamma, value = GAMMAS[first_best], float(metrics[first_best])
        for root in real:
            if (height := float(polynomial.polyval(root, coefficients))) > value:
                gamma, value = float(root), height
        target = next_level(level, gamma)
        if abs(target - level) < 1e-9:
            return Target(level, "held: metric at its maximum")
        return Target(target, f"gamma* {gamma:.2f} {'brightens' if gamma > 1 else 'darkens'}")
