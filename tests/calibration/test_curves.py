"""Properties of the curves from which a response is built."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.response.curves import (
    Ends,
    InverseCurve,
    _responses,
    families,
    fit_family,
    nodes,
    octaves,
    residuals,
    residuals_from_others,
    usable,
)
from calibration.response.free_curve import _roughness
from calibration.response.tones import Tones, tones_by_exposure

from .sweeps import TIMES_US, Bench

GAMMA = families()[1]


def gamma_curve(gamma: float) -> InverseCurve:
    return GAMMA.curve(0.0, np.array([gamma]), 255.0)


def sweep_of(response: str) -> Tones:
    return tones_by_exposure(Bench(response).sweep(TIMES_US))


def test_every_response_of_the_basis_rises_from_0_to_1() -> None:
    light = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 400)])
    for curve in _responses(light):
        assert (curve[0], curve[-1]) == pytest.approx((0.0, 1.0), abs=1e-9)
        assert (np.diff(curve) > 0).all()


@pytest.mark.parametrize("gamma", [0.45, 1.0])
def test_the_slope_is_that_of_the_curve(gamma: float) -> None:
    greys = np.array([3.3, 17.3, 60.6, 200.2])  # none at a node, where the curve has a bend
    curve = gamma_curve(gamma)
    bent = InverseCurve(curve.greys, curve.stops + 0.02 * np.sin(np.arange(len(curve.greys))), 0.0)
    step = 1e-3
    by_hand = (bent.at(greys + step) - bent.at(greys - step)) / (2 * step)
    assert bent.slope(greys) == pytest.approx(by_hand, rel=1e-3)


def test_a_group_seen_at_two_exposures_speaks_of_the_curve_and_one_seen_once_does_not() -> None:
    greys = np.array([[0.0, 0.0], [30.0, 0.0], [120.0, 60.0], [255.0, 255.0]])
    tones = Tones(np.arange(4.0), greys, np.full(greys.shape, 0.1), 0.0)
    assert usable(tones, Ends.of(tones)).sum(axis=0).tolist() == [2, 0]


def test_what_others_predict_is_farther_off_than_what_a_median_helped_to_predict() -> None:
    tones = sweep_of("s_shaped")
    within = usable(tones, Ends.of(tones))
    own = np.abs(residuals(gamma_curve(0.6), tones, within)[within])
    others = np.abs(residuals_from_others(gamma_curve(0.6), tones, within))
    assert (others >= own).all()
    assert (others > 1.5 * own).any()


def test_a_straight_line_over_the_logarithm_of_grey_is_not_rough_and_a_bend_is() -> None:
    grid = octaves(nodes(0.0, 255.0), 0.0)
    rough = _roughness(grid)
    assert np.abs(rough @ (3.0 * grid - 1.0)).max() < 1e-6 * np.abs(rough).max()
    assert grid**2 @ rough @ grid**2 == pytest.approx(4.0 * (grid[-1] - grid[0]), rel=0.2)  # second derivative 2


def test_a_fit_is_not_ruled_by_what_moved() -> None:
    """A third of the groups had three times the light at a third of the exposures."""
    tones = sweep_of("gamma")
    greys = tones.greys.copy()
    greys[::3, ::3] = np.minimum(greys[::3, ::3] * 3.0 + 5.0, 255.0)
    moved = replace(tones, greys=greys)
    ends = Ends.of(tones)
    fit = fit_family(GAMMA, moved, ends, usable(moved, ends))
    assert fit.parameters[0] == pytest.approx(1 / 2.2, rel=0.01)
