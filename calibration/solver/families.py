"""Families of response curves with few parameters: linear, power laws, and our own basis in the manner of EMoR."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration.response.solution import ResponseModel
from calibration.solver.inverse_curve import Ends, InverseCurve, Misfit, nodes, residuals
from calibration.solver.tones import Curve, Tones

BASIS_CURVES = 4
"""Four in five curves of our family are then matched to 0.22 grey levels (root mean square), the worst to 0.6."""

LEAST_BLACK_GREY = -2.0
"""A sensor may hide the lowest grey levels below 0, but hardly more."""

BLACK_RANGE_GREY = 0.5
"""How far black may be from the lowest median seen, since grey levels are whole numbers."""

_ROUNDS = 30
"""Only a bound: fits end when they stop improving."""


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Curves that follow from a few parameters.

    Attributes
    ----------
    model
        Its name.
    names
        Names of the parameters, apart from black.
    start, least, most
        Where a fit starts, and its bounds.
    log2_light
        log2 of the light at shares of full scale (above 0, up to 1), by the parameters.
    """

    model: ResponseModel
    names: tuple[str, ...]
    start: tuple[float, ...]
    least: tuple[float, ...]
    most: tuple[float, ...]
    log2_light: Callable[[Curve, Curve], Curve]

    def curve(self, black: float, parameters: Curve, saturation: float) -> InverseCurve:
        """The member with these parameters. Black is light that was added before the response, and is subtracted."""
        greys = nodes(black, saturation)
        light = self._light(greys / saturation, parameters)
        offset = self.light_of_black(black, parameters, saturation)
        stops = np.log2(np.maximum(light - offset, 1e-9))
        return InverseCurve(greys, np.maximum.accumulate(stops - stops[-1]), black)

    def light_of_black(self, black: float, parameters: Curve, saturation: float) -> float:
        """The light (that at saturation is 1) that was added before the response, to be `black` without any other."""
        return float(self._light(np.array([black / saturation]), parameters)[0])

    def _light(self, share: Curve, parameters: Curve) -> Curve:
        size = np.exp2(self.log2_light(np.maximum(np.abs(share), 1e-6), parameters))
        return np.where(np.abs(share) < 1e-6, 0.0, np.sign(share) * size)


@dataclass(frozen=True, slots=True, eq=False)
class FamilyFit:
    """The member of a family that explains a sweep best."""

    family: Family
    black: float
    parameters: Curve
    curve: InverseCurve
    misfit: Misfit


def fit_family(
    family: Family, tones: Tones, ends: Ends, within: NDArray[np.bool_], near: FamilyFit | None = None
) -> FamilyFit:
    """Robust least squares of the residuals (Levenberg & Marquardt); black is fitted if not seen.

    A fit to nearly the same tones is found sooner from `near`, the fit of the others.
    """
    least = np.array([ends.lowest - BLACK_RANGE_GREY if ends.black_seen else LEAST_BLACK_GREY, *family.least])
    most = np.array([ends.lowest + BLACK_RANGE_GREY, *family.most])

    def curve_of(unknown: Curve) -> InverseCurve:
        return family.curve(float(unknown[0]), unknown[1:], ends.saturation)

    def errors_of(unknown: Curve) -> Curve:
        size = residuals(curve_of(unknown), tones, within)[within] / tones.errors[within]
        limit = 3.0 * 1.48 * max(float(np.median(np.abs(size))), 0.3)
        # Beyond the limit the square of this grows only in proportion to the error.
        return np.asarray(np.sign(size) * np.sqrt(np.where(np.abs(size) < limit, size**2, limit * np.abs(size))))

    start = np.array([ends.lowest, *family.start] if near is None else [near.black, *near.parameters])
    best = np.clip(start, least, most)
    errors = errors_of(best)
    damping = 1e-2
    jacobian: Curve | None = None
    for _ in range(_ROUNDS):
        if jacobian is None:
            jacobian = np.stack([_derivative(errors_of, errors, best, i, most) for i in range(len(best))], axis=1)
        square = jacobian.T @ jacobian
        square += np.diag(damping * np.diag(square) + 1e-9)
        trial = np.clip(best - np.linalg.solve(square, jacobian.T @ errors), least, most)
        tried = errors_of(trial)
        gain = 1.0 - float(tried @ tried) / max(float(errors @ errors), 1e-12)
        if gain > 0:
            best, errors, damping, jacobian = trial, tried, damping / 5, None
        else:
            damping *= 10
        if abs(gain) < 1e-5 or damping > 1e6:
            break
    curve = curve_of(best)
    return FamilyFit(family, float(best[0]), best[1:], curve, Misfit.of(curve, tones, within))


def _derivative(errors_of: Callable[[Curve], Curve], errors: Curve, at: Curve, index: int, most: Curve) -> Curve:
    step = 1e-3 if at[index] + 1e-3 <= most[index] else -1e-3
    moved = at.copy()
    moved[index] += step
    return (errors_of(moved) - errors) / step


def families() -> tuple[Family, ...]:
    """All families, the simplest first."""
    count = BASIS_CURVES
    return (
        Family("linear", (), (), (), (), lambda share, _: np.log2(share)),
        Family("gamma", ("gamma",), (0.6,), (0.2,), (2.0,), lambda share, gamma: np.log2(share) / gamma[0]),
        Family(
            "emor",
            tuple(f"basis_{i + 1}" for i in range(count)),
            (0.0,) * count,
            (-60.0,) * count,
            (60.0,) * count,
            _log2_light_of_basis,
        ),
    )


def _log2_light_of_basis(share: Curve, weights: Curve) -> Curve:
    mean, basis = _basis()
    grid = np.log2(_SHARES)
    # Below the grid the power law of its lower end continues.
    values = mean + weights @ basis
    slope = (values[1] - values[0]) / (grid[1] - grid[0])
    at = np.log2(share)
    return np.asarray(np.interp(at, grid, values) + slope * np.minimum(at - grid[0], 0.0))


_SHARES = np.concatenate([np.geomspace(0.002, 0.1, 40, endpoint=False), np.linspace(0.1, 1.0, 60)])
"""Shares of full scale at which the basis is kept: dense in the shadows."""


@lru_cache(maxsize=1)
def _basis() -> tuple[Curve, Curve]:
    """Mean and principal components of log2 light over `_SHARES`, shapes (100,) and (BASIS_CURVES, 100)."""
    light = np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 4000)])
    curves = np.array([np.log2(np.interp(_SHARES, grey, light)) for grey in _responses(light)])
    mean = curves.mean(axis=0)
    # An error in log light counts by how much it moves grey levels, which is roughly in proportion to them.
    _, _, directions = np.linalg.svd((curves - mean) * _SHARES, full_matrices=False)
    return mean, directions[:BASIS_CURVES] / _SHARES


def _responses(light: Curve) -> list[Curve]:
    """The family: what cameras do to light, from 0 at 0 to 1 at 1, rising.

    Power laws, alone and with a toe and shoulder of any strength; power laws with a straight start, as in video;
    saturating curves, as of film; logarithms.
    """
    curves = []
    for gamma in np.linspace(0.3, 1.0, 8):
        power = light**gamma
        s_curve = power * power * (3.0 - 2.0 * power)
        curves += [(1.0 - strength) * power + strength * s_curve for strength in (-0.3, 0.0, 0.3, 0.6, 0.9)]
        for start in (0.003, 0.02):
            slope = gamma * start ** (gamma - 1.0)
            bent = np.where(light < start, slope * light, power - (1.0 - gamma) * start**gamma)
            curves.append(bent / bent[-1])
        curves += [power * (1.0 + knee) / (power + knee) for knee in (0.3, 1.0)]
    curves += [np.log1p(steep * light) / np.log1p(steep) for steep in (3.0, 10.0, 30.0, 100.0, 1000.0)]
    return curves
