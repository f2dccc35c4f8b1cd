"""Policies `shim2018` and `mehta2020`: gradient information under gamma transformations, and a nonlinear step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.search import PolynomialFit, PredictedCurve, best_sample
from autoexpose_daemon.control.setup import ControlSetup

LEAST_VALUE = 1.0
"""Of the exposure value: at 0 the law would stand still, below it would push the wrong way."""


@dataclass(frozen=True, slots=True)
class GammaStep:
    """``dE = k_p (r - 1) EV`` with ``r - 1 = d tan(atan(1/d) (1 - gamma))`` (eq. 17 and 18 of Begin & Hunter 2022).

    The E that public code multiplies in eq. (17) is the photographic exposure value ``EV = log2(F^2 / (t g))``, t in
    seconds: MIT-Bilab/vo-autoexpose (`find_exposure_value`), ishaanmht/aer_auto_exposure_gradient (`src/auto_exp.cpp`).
    So k_p belongs to it, and to the aperture.
    """

    proportional_gain: float  # k_p
    aperture: float  # F, the F-number of the lens
    steepness: float = 0.1  # d, 0.1 in both codes

    def exposure_value(self, level: float) -> float:
        """EV at an exposure level (stops), at least `LEAST_VALUE`: 22.9 - level for f/2.8."""
        return max(math.log2(self.aperture**2 * 1e6) - level, LEAST_VALUE)

    def change(self, level: float, gamma: float) -> float:
        """dE in stops at an exposure level: positive below gamma 1, negative above."""
        ratio = self.steepness * math.tan(math.atan(1 / self.steepness) * (1 - gamma))
        return self.proportional_gain * ratio * self.exposure_value(level)


GAMMAS = (0.1, 0.5, 0.8, 1.0, 1.2, 1.5, 1.9)
"""The anchors that public implementations of Shim et al. 2018 share; below 1 a picture brightens."""

DEGREE = 5
"""Of the polynomial through the anchors, from the same implementations."""

STEP = GammaStep(proportional_gain=0.4, aperture=2.8)
"""From the header of Mehta's code (another version has 0.2). With Begin & Hunter's k_p of 1.6 at f/1.2, which belong to
the anchors of `mehta2020`, this law oscillates at rest: by more than 0.1 stop in half of 90 runs, with this step in
none (still scenes with 0.5 to 1.5 stops of contrast, six lights, three starts, delay 2)."""

_GRID: NDArray[np.float64] = np.arange(10, 191) / 100
"""Where gamma* is looked for: the range of the anchors in steps of 0.01."""


def gamma_table(gamma: float) -> NDArray[np.uint8]:
    """``I_out = 255 (I_in / 255) ** gamma`` (eq. 15) for every grey level: uint8, shape (256,)."""
    return np.rint(255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.uint8)


def next_level(level: float, gamma: float) -> float:
    """The exposure level (stops) that follows from gamma* (eq. 17 to 19).

    gamma* < 1 says that a brighter picture shows more, so the level rises; steps that darken are halved (alpha).
    Eq. (17) multiplies E, whose unit the paper leaves open; here it is that of the public codes, see `GammaStep`.
    """
    return level + (0.5 if gamma >= 1 else 1.0) * STEP.change(level, gamma)


class Shim2018(ExposurePolicy):
    """Finds gamma* that maximises gradient information, and steps as eq. (15) to (19) say. No state.

    An image that has equal gradient under every gamma (black, white) says nothing: gamma* = 1, the exposure is held.
    """

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance(ExposurePriority())
        self._fit = PolynomialFit(GAMMAS, DEGREE)
        tables = np.stack([gamma_table(gamma) for gamma in GAMMAS])
        self._curve = PredictedCurve(setup.metric, tables, GAMMAS.index(1.0))

    def decide(self, observation: Observation) -> Target:
        """The law's step from the level of this frame."""
        metrics = self._curve.measure(observation)
        level = observation.setting.level
        if np.ptp(metrics) == 0:
            return Target(level, "held: no gradient under any gamma")
        curve: NDArray[np.float64] = np.asarray(polynomial.polyval(_GRID, self._fit.coefficients(metrics)), np.float64)
        gamma = best_sample(_GRID, curve, origin=1.0).position
        target = next_level(level, gamma)
        if abs(target - level) < 1e-9:
            return Target(level, "held: metric at its maximum")
        return Target(target, f"gamma* {gamma:.2f} {'brightens' if gamma < 1 else 'darkens'}")


MEHTA_GAMMAS = (1 / 1.9, 1 / 1.5, 1 / 1.2, 1.0, 1.2, 1.5, 1.9)
"""Anchors of Mehta's code, which raises grey levels to 1/gamma: above 1 a picture brightens, unlike in eq. (15)."""

MEHTA_STEP = GammaStep(proportional_gain=1.6, aperture=1.2)
"""As Begin & Hunter set them for their comparison (section 3.3; `vo_autoexpose.h`, `vo_autoexpose_node.cpp`). Mehta's
own code has f/2.8 and a k_p of 0.2 to 0.4."""


def mehta_level(level: float, gamma: float) -> float:
    """The exposure level (stops) that follows from gamma* by eq. (17) and (18), on exposure value.

    Exposure value falls as exposure rises, and gamma is the inverse of eq. (15)'s: the two invert the law twice. There
    is no alpha of eq. (19): Mehta's code has it commented out, on the branch that darkens; Begin & Hunter's has none.
    """
    return level - MEHTA_STEP.change(level, gamma)


class Mehta2020(ExposurePolicy):
    """Gamma* from the roots of the fitted polynomial's derivative, and the step of `mehta_level`. No state.

    Read in ishaanmht/aer_auto_exposure_gradient, `src/auto_exp.cpp` (the paper was not at hand): anchors, degree, the
    law on exposure value. A root counts if it lies between the outer anchors and the polynomial there exceeds the best
    anchor; else the best anchor is taken, the first among equals: an image without gradient under any gamma darkens, so
    white is left, but black is not. Our own: the metric is `GradientMetric` (their gradient loses negative slopes) and
    every frame is used (theirs skips every other one). `mehta2020-code` is the law as Begin & Hunter's code runs it.
    """

    FLOW = "farneback"

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance()
        self._fit = PolynomialFit(MEHTA_GAMMAS, DEGREE)
        tables = np.stack([gamma_table(1 / gamma) for gamma in MEHTA_GAMMAS])
        self._curve = PredictedCurve(setup.metric, tables, MEHTA_GAMMAS.index(1.0))

    def decide(self, observation: Observation) -> Target:
        """The law's step from the level of this frame."""
        metrics = self._curve.measure(observation)
        level = observation.setting.level
        first_best = int(np.argmax(metrics))
        coefficients = self._fit.coefficients(metrics)
        roots = np.asarray(polynomial.polyroots(polynomial.polytrim(polynomial.polyder(coefficients), 1e-12)))
        real = roots.real[(abs(roots.imag) < 1e-9) & (roots.real > MEHTA_GAMMAS[0]) & (roots.real < MEHTA_GAMMAS[-1])]
        gamma, value = MEHTA_GAMMAS[first_best], float(metrics[first_best])
        for root in real:
            if (height := float(polynomial.polyval(root, coefficients))) > value:
                gamma, value = float(root), height
        target = mehta_level(level, gamma)
        if abs(target - level) < 1e-9:
            return Target(level, "held: metric at its maximum")
        return Target(target, f"gamma* {gamma:.2f} {'brightens' if gamma > 1 else 'darkens'}")
