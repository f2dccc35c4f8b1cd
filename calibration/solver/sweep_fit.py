"""The curve fitted to a sweep, and how far it may be off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.solver.exposure_offset import offset_changes
from calibration.solver.families import FamilyFit, fit_family
from calibration.solver.free_curve import FreeFit, fit_as_smooth
from calibration.solver.inverse_curve import Ends, InverseCurve, usable
from calibration.solver.tones import Curve, Tones

FOLDS = 8
"""Fits without some exposures."""

STUDENT = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31)
"""Student's t within which 95 % lie, by degrees of freedom from 1: few exposures hardly know their own errors."""

COUNTED = 0.4
"""Of the squares of what chance and the kind of curve do, with which the error covers simulated sweeps."""

INTERPOLATED_GREY = 0.004
"""Error of the curve between its nodes, in grey levels."""

OF_OFFSET = 0.7
"""So much of what the best offset changes is a standard error: if it is real, the curve is off by all of it."""

UNVOUCHED = 4.0
"""So much further off may a free curve be where a scene of one brightness lets wrong times bend it."""


@dataclass(frozen=True, slots=True, eq=False)
class SweepFit:
    """What was fitted to the tones of a sweep.

    Attributes
    ----------
    tones, ends, within
        The tones, where grey levels end, and which medians count.
    simplest, free
        The simplest family that explains the medians as well as any, and a curve of free shape.
    explained
        Whether that family explains them as well as the free curve.
    uniform
        Whether the scene has one brightness only, so that grey levels cannot tell a curve from wrong exposure times.
    anchor
        The node from which errors count, as only differences matter.
    """

    tones: Tones
    ends: Ends
    within: NDArray[np.bool_]
    simplest: FamilyFit
    free: FreeFit
    explained: bool
    uniform: bool
    anchor: int

    @property
    def curve(self) -> InverseCurve:
        """The response found."""
        return self.simplest.curve if self.explained else self.free.curve

    def errors_stops(self) -> Curve:
        """Standard errors at the curve's nodes, shape (nodes,).

        The formal error is that of a free curve, and says nothing of a family's, which bends less.
        """
        chance = self._left_out_stops() ** 2 + (0.0 if self.explained else self.free.errors_stops**2)
        squares = COUNTED * (chance + self._model_stops() ** 2)
        freedom = len(self.tones.levels) - 2
        if freedom <= len(STUDENT):
            squares = squares * (STUDENT[max(freedom, 1) - 1] / 2.0) ** 2
        between = INTERPOLATED_GREY * self.curve.slope(self.curve.greys)
        return np.asarray(np.sqrt(squares + self._offset_squares() + between**2))

    def _left_out_stops(self) -> Curve:
        """By how much the curve depends on single exposures: standard errors at its nodes.

        The jackknife (Quenouille, Tukey): fits without every n-th exposure, n at most `FOLDS`.
        """
        tones, fit = self.tones, self.simplest
        folds = min(len(tones.levels), FOLDS)
        curves = []
        for fold in range(folds):
            kept = np.arange(len(tones.levels)) % folds != fold
            part = replace(tones, levels=tones.levels[kept], greys=tones.greys[kept], errors=tones.errors[kept])
            within = usable(part, self.ends)
            if not within.any():
                continue
            if self.explained:
                curve = fit_family(fit.family, part, self.ends, within, fit).curve
            else:
                curve = fit_as_smooth(part, within, fit.curve)
            curves.append(self._from_anchor(curve.at(fit.curve.greys)))
        if len(curves) < 2:
            return np.zeros(len(fit.curve.greys))
        return np.asarray(np.sqrt((len(curves) - 1) * np.var(curves, axis=0)))

    def _model_stops(self) -> Curve:
        """What the choice of the kind of curve may have done."""
        difference = self._from_anchor(self.simplest.curve.stops - self.free.curve.stops)
        if self.explained:
            return difference
        if self.uniform:
            return UNVOUCHED * difference
        few = len(self.tones.levels) < FOLDS
        return np.maximum(np.abs(self.free.smoothed_stops), np.abs(difference) if few else 0.0)

    def _offset_squares(self) -> Curve:
        """What an offset of all exposures would do, squared."""
        if self.uniform:
            return np.zeros(len(self.curve.greys))
        found, error = offset_changes(self.tones, self.within, self.simplest.curve)
        return OF_OFFSET**2 * self._from_anchor(found) ** 2 + self._from_anchor(error) ** 2

    def _from_anchor(self, stops: Curve) -> Curve:
        return np.asarray(stops - stops[self.anchor])
