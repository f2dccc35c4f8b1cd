"""How the light will have changed according to an earlier drive, and how far to believe that."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.light_ahead import SPREADS, UNPROVEN, WINDOW_FRAMES, LightAhead

SCALE_STOPS = 1.0
"""Scale of the difference between foretold and seen changes of light; its distribution has long tails (Laplace)."""

FORGOTTEN_FRAMES = 300
"""After five seconds at 60 Hz without a series, what the last one foretold says nothing about the next."""

LEAST_BELIEF, MOST_BELIEF = 0.05, 0.95

CLEARLY_STOPS = 20.0
"""A greater difference counts as much as this one."""

NARROWEST_FRAMES = 0.5

RISE_STOPS = 0.25
"""Rises of the light that differ by less are counted as one."""


@dataclass(slots=True)
class Foresight:
    """Weighs what an earlier drive saw against light that follows its own recent pattern.

    Where exactly the rig is on the route is not known, so each place it may be at is a hypothesis. How well it explains
    the light of the last second gives its probability, and all of them against unchanged light give the belief.

    Attributes
    ----------
    belief
        Probability that the series foretells the light, from what it foretold so far.
    untold_frames
        Since the latest series.
    """

    STATE: ClassVar[tuple[str, ...]] = ("belief", "untold_frames")

    belief: float = UNPROVEN
    untold_frames: int = 0

    def rest(self) -> None:
        """A frame without a series. After a while, the next series is of another drive."""
        self.untold_frames += 1
        if self.untold_frames >= FORGOTTEN_FRAMES:
            self.belief = UNPROVEN

    def rises(
        self, ahead: LightAhead, changes: Collection[float], frames: int, otherwise: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """By how much the light may rise within the next `frames`, and with which probabilities.

        Parameters
        ----------
        ahead
            What the earlier drive saw.
        changes
            Of the light from frame to frame so far, stops, oldest first.
        frames
            How far to look ahead.
        otherwise
            The rise if the series is wrong, stops.

        Returns
        -------
            Rises in stops, and probabilities that sum to 1; float64, both of the same length.
        """
        self.untold_frames = 0
        reach = math.ceil(SPREADS * ahead.spread_frames)
        aside = np.arange(-reach, reach + 1)
        here = ahead.now + aside
        window = max(min(WINDOW_FRAMES, len(changes), ahead.now - reach), 0)
        seen = sum(itertools.islice(changes, len(changes) - window, None))
        levels = np.array(ahead.levels)
        before, now, then = (levels.take(here + shift, mode="clip") for shift in (-window, 0, frames))

        prior = np.exp(-0.5 * (aside / max(ahead.spread_frames, NARROWEST_FRAMES)) ** 2)
        explained = prior / prior.sum() * _likelihood(seen - (before - now))
        right, wrong = float(explained.sum()), float(_likelihood(seen))
        share = self.belief * right / (self.belief * right + (1.0 - self.belief) * wrong)
        # Every change stays in the window for as many frames as it has, but counts once.
        self._prove(math.log(right / wrong) / WINDOW_FRAMES)

        rises, which = np.unique(np.round((now - then) / RISE_STOPS) * RISE_STOPS, return_inverse=True)
        probabilities = np.bincount(which, explained * (share / right), len(rises))
        return np.append(rises, otherwise), np.append(probabilities, 1.0 - share)

    def _prove(self, evidence: float) -> None:
        odds = math.exp(evidence) * self.belief / (1.0 - self.belief)
        self.belief = min(max(odds / (1.0 + odds), LEAST_BELIEF), MOST_BELIEF)


def _likelihood(stops: NDArray[np.float64] | float) -> NDArray[np.float64]:
    return np.exp(-np.minimum(np.abs(stops), CLEARLY_STOPS) / SCALE_STOPS)
