"""Where the view changes, not the light: which level served at this place on an earlier drive."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.light_ahead import WINDOW_FRAMES, LightAhead
from autoexpose_daemon.control.policies.belief.foresight import Foresight

FAR_STOPS: Final = 2.0
"""Levels farther apart than this are good for different parts of a view: a room, and what is behind its window."""

LIT_STOPS: Final = 2.0
"""If the light changed by less between two places whose levels are far apart, it was the view that changed."""

SURE: Final = 0.97
"""Probability of a level, given where the rig may be, from which it counts as known."""

COMPARED: Final = 60
LEAST_COMPARED: Final = 10
"""Settled frames that show by how much this drive's levels differ from the earlier one's."""

SETTLED_STOPS: Final = 0.75
BLIND_SHARE: Final = 0.8
"""A frame is settled if taken this near to what promises most, with less than this share black or saturated."""

HIDDEN_SHARE: Final = 0.25
"""Share of the picture that must be saturated before a leap down, and black before a leap up."""

BETTER: Final = 2.0
"""A remembered level is left again only for one that promises so many times as much."""

PROVEN_WORTH: Final = 0.6
"""A leap was right if its level is worth this share of the level before it."""

BELIEVED: Final = 0.3
BELIEVED_AGAIN: Final = 0.9
"""Belief in the light that was foretold from which levels are followed: at first, when it need only not be disproved,
since steady light never proves it; and after leaps that were wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class Prospect:
    """A frame, and what levels promise after it.

    Attributes
    ----------
    level
        It was taken with, stops.
    saturated_share, black_share
        0 to 1, a mean over cameras.
    levels, worth
        Stops and what they promise, float64, (n,).
    """

    level: float
    saturated_share: float
    black_share: float
    levels: NDArray[np.float64]
    worth: NDArray[np.float64]

    @property
    def best(self) -> float:
        """The level that promises most, stops."""
        return self.levels.item(int(self.worth.argmax()))

    def best_near(self, level: float) -> tuple[float, float]:
        """The level that promises most within `FAR_STOPS` of another, and what it promises."""
        near = np.flatnonzero(np.abs(self.levels - level) <= FAR_STOPS)
        best = near[self.worth[near].argmax()]
        return self.levels.item(int(best)), self.worth.item(int(best))


@dataclass(slots=True)
class ServedBefore:
    """Leaps to the level that served where an earlier drive saw the view change, and stays there.

    A window has a good level of its own, many stops from the room's. What it is worth does not show while it is
    saturated, so without memory the map notices late, and looks for it in steps.

    Attributes
    ----------
    differences
        By how much what promises most exceeds what served on the earlier drive, where exposure had settled within the
        camera's limits, stops, newest last.
    leap, left
        The level of a leap whose frame has not come yet, and the one before it, stops; None: no leap is on its way.
    waited
        Frames since the leap was decided.
    proven
        Leaps that were right less those that were wrong.
    """

    STATE: ClassVar[tuple[str, ...]] = ("differences", "leap", "left", "waited", "proven")

    differences: list[float] = field(default_factory=list)
    leap: float | None = None
    left: float = 0.0
    waited: int = 0
    proven: int = 0

    def pass_frame(self) -> None:
        """Another frame has come, whoever decides on it."""
        self.waited += 1

    def rest(self, *, forget: bool) -> None:
        """A frame without a memory of this place; `forget` what was proven: the next memory is of another drive."""
        self.leap = None
        if forget:
            self.differences, self.proven = [], 0

    def target(self, ahead: LightAhead, foresight: Foresight, frames: int, prospect: Prospect) -> float | None:
        """The level to go to for a frame so many `frames` ahead (stops); None: what the map promises decides.

        `foresight` has weighed `ahead` for the present frame.
        """
        here, places = foresight.here, foresight.places
        served = np.array(ahead.levels)
        then = served.take(here + frames, mode="clip")
        expected = _median(then, places)
        self._compare(served, ahead.now, _median(served.take(here, mode="clip"), places), prospect)
        if len(self.differences) < LEAST_COMPARED:
            return None
        remembered = float(np.clip(expected + np.median(self.differences), prospect.levels[0], prospect.levels[-1]))
        self._judge(prospect, frames)
        if self.leap is not None and abs(remembered - self.leap) <= FAR_STOPS:
            return self.leap
        self.leap = None
        known = float(places[np.abs(then - expected) <= FAR_STOPS].sum()) >= SURE
        far = abs(remembered - prospect.best) > FAR_STOPS
        if known and far and self._trusts(foresight.belief) and _view_changes(ahead, ahead.now + frames):
            return self._followed(remembered, prospect)
        return None

    def _followed(self, remembered: float, prospect: Prospect) -> float | None:
        """Stay near a remembered level, or leap to it; None if the map is to decide all the same."""
        if abs(remembered - prospect.level) <= FAR_STOPS:
            near, worth = prospect.best_near(remembered)
            return near if prospect.worth.max() < BETTER * worth else None
        hidden = prospect.saturated_share if remembered < prospect.level else prospect.black_share
        if hidden < HIDDEN_SHARE:
            return None
        self.leap, self.left, self.waited = remembered, prospect.level, 0
        return remembered

    def _compare(self, served: NDArray[np.float64], now: int, here: float, prospect: Prospect) -> None:
        around = served[max(now - 3, 0) : now + 4]
        settled = abs(prospect.best - prospect.level) < SETTLED_STOPS and float(np.ptp(around)) < 2 * SETTLED_STOPS
        free = prospect.levels[0] < prospect.best < prospect.levels[-1]
        if settled and free and prospect.saturated_share + prospect.black_share < BLIND_SHARE:
            self.differences = [*self.differences[1 - COMPARED :], prospect.best - here]

    def _judge(self, prospect: Prospect, frames: int) -> None:
        """Count a leap whose frame has come as right or wrong; one whose frame does not come is forgotten."""
        if self.leap is None:
            return
        if abs(prospect.level - self.leap) < SETTLED_STOPS:
            now, before = np.interp([prospect.level, self.left], prospect.levels, prospect.worth)
            self.proven += 1 if now >= PROVEN_WORTH * before else -1
            self.leap = None
        elif self.waited > frames + 1:
            self.leap = None

    def _trusts(self, belief: float) -> bool:
        return self.proven > 0 or belief >= (BELIEVED if self.proven == 0 else BELIEVED_AGAIN)


def _view_changes(ahead: LightAhead, then: int) -> bool:
    """Whether a level far from that of place `then` served within the second before now, in about the same light."""
    then = min(then, len(ahead.levels) - 1)
    before = slice(max(ahead.now - WINDOW_FRAMES, 0), then)
    far = np.abs(np.array(ahead.levels[before]) - ahead.levels[then]) > FAR_STOPS
    lit_alike = np.abs(np.array(ahead.risen[before]) - ahead.risen[then]) < LIT_STOPS
    return bool((far & lit_alike).any())


def _median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """The weighted median; weights sum to 1."""
    order = values.argsort()
    middle = int(weights[order].cumsum().searchsorted(0.5))
    return values.item(int(order[min(middle, len(order) - 1)]))
