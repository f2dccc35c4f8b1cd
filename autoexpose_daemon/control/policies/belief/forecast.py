"""What the light does next, how far apart two frames are, and how many frames pass until one shows a decision."""

from __future__ import annotations

import itertools
import math
import statistics
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.inputs import SPREADS, UNPROVEN, WINDOW_FRAMES, LightAhead
from autoexpose_daemon.control.metrics import extension as _native
from autoexpose_daemon.control.snapshot import Built, Stateful

HISTORY = 96
"""Frames: one and a half seconds at 60 Hz, three periods of a shadow that passes twice a second."""

LEAST_FRAMES = 12
"""Frames that a period must have explained before it is believed, and at least two periods."""

LEAST_CHANGE = 0.1
"""Standard deviation of the changes (stops per frame) below which following a period gains nothing."""

RESIDUE = 0.15
"""Share of the changes' variance that a period may leave unexplained. Variance, not power: a ramp, the same change
every frame, would otherwise have a period of 2 frames."""

RAMP_FRAMES = 4
RAMP_SLOPE = 0.03
"""A ramp: this many changes in a row with one sign, each of at least this many stops."""

SWING_FRAMES = 12
"""Frames over which `Forecast.swing` looks: as long as the longest beat of flicker and frame rate."""

LONGEST_LEAD = 1.0
"""Stops. A ramp may end at any frame, and then the lead is the error."""


@dataclass(slots=True)
class Forecast(Stateful):
    """The changes of light from frame to frame, and what follows from them."""

    changes: deque[float] = field(default_factory=lambda: deque(maxlen=HISTORY))  # stops per frame, oldest first

    def add(self, change: float, frames: int = 1) -> None:
        """One more frame, whose light differs by `change` stops from the frame before, which was `frames` ago.

        Frames that are missing between them are filled in: as the period foretells, or evenly.
        """
        missing = min(frames, HISTORY) - 1
        period = self.period() if missing else None
        for left in range(missing, 0, -1):
            filled = change / (left + 1) if period is None else self.changes[-period]
            self.changes.append(filled)
            change -= filled
        self.changes.append(change)

    def path(self, ahead: Sequence[int], steady: bool) -> list[float]:
        """Stops by which the light will have risen so many frames from now each; 0 when there is no pattern in it.

        A ramp is led only when `steady`, with the camera moving slowly: in fast motion content causes such slopes too.
        """
        period = self.period()
        if period is not None:
            cycle = np.array(self.changes)[-period:]
            return [float(sum(cycle[i % period] for i in range(frames)) - frames * cycle.mean()) for frames in ahead]
        slope = self._slope() if steady else 0.0
        return [min(max(slope * frames, -LONGEST_LEAD), LONGEST_LEAD) for frames in ahead]

    def swing(self) -> float:
        """Stops that the light has risen and fallen again over the last `SWING_FRAMES`, without what remains of it."""
        recent = list(self.changes)[-SWING_FRAMES:]
        return sum(map(abs, recent)) - abs(sum(recent))

    def period(self) -> int | None:
        """Frames after which the changes repeat themselves; None when they do not, or are small."""
        return _native.find_period(np.array(self.changes), LEAST_FRAMES, LEAST_CHANGE**2, RESIDUE) or None

    def _slope(self) -> float:
        if len(self.changes) <= RAMP_FRAMES:
            return 0.0
        recent = [self.changes[-frame] for frame in range(1, RAMP_FRAMES + 1)]
        ramp = min(recent) > RAMP_SLOPE or max(recent) < -RAMP_SLOPE
        return statistics.median(recent) if ramp else 0.0


SMOOTHED_FRAMES = 5
"""Changes are compared by their sums over so many frames: two drives see the same change a frame or two apart."""

SCALE_STOPS = 0.5
"""Scale of the difference between foretold and seen changes of light; its distribution has long tails (Laplace)."""

FORGOTTEN_FRAMES = 300
"""After five seconds at 60 Hz without a series, what the last one foretold says nothing about the next."""

LEAST_BELIEF, MOST_BELIEF = 0.05, 0.95

NARROWEST_FRAMES = 0.5


@dataclass(slots=True)
class Foresight(Stateful):
    """Weighs what an earlier drive saw against light that follows its own recent pattern.

    Where exactly the rig is on the route is not known, so each place it may be at is a hypothesis. How well it explains
    when the light of the last second changed, and by how much, gives its probability, and all of them against unchanged
    light give the belief.
    """

    belief: float = UNPROVEN  # probability that the series foretells the light, from what it foretold so far
    untold_frames: int = 0  # since the latest series that was used
    # indices in the latest series at which the rig may be, and their probabilities, which sum to 1; not kept from one
    # frame to the next
    here: Built[NDArray[np.int64]] = field(default_factory=lambda: np.zeros(1, np.int64))
    places: Built[NDArray[np.float64]] = field(default_factory=lambda: np.ones(1))

    def rest(self) -> None:
        """A frame without a series to go by. After a while, the next series is of another drive."""
        self.untold_frames += 1
        if self.untold_frames >= FORGOTTEN_FRAMES:
            self.belief = UNPROVEN

    def weigh(self, ahead: LightAhead, changes: Collection[float]) -> float:
        """The probability that what the earlier drive saw comes again; sets that of each place, `places`.

        `changes` are those of the light from frame to frame so far, stops, oldest first.
        """
        self.untold_frames = 0
        reach = math.ceil(SPREADS * ahead.spread_frames)
        aside = np.arange(-reach, reach + 1)
        here = ahead.now + aside
        risen = np.array(ahead.risen)
        prior = np.exp(-0.5 * (aside / max(ahead.spread_frames, NARROWEST_FRAMES)) ** 2)
        window = max(min(WINDOW_FRAMES, len(changes), ahead.now - reach), 0)
        misfits, otherwise_misfit = _misfits(risen, here, changes, window)

        fits = np.log(prior / prior.sum()) - misfits
        likeliest = float(fits.max())
        explained = np.exp(fits - likeliest)
        self.here, self.places = here, explained / explained.sum()
        evidence = likeliest + math.log(explained.sum()) + otherwise_misfit
        share = _shifted(self.belief, evidence)
        # Every change stays in the window for as many frames as it has, but counts once.
        self.belief = min(max(_shifted(self.belief, evidence / WINDOW_FRAMES), LEAST_BELIEF), MOST_BELIEF)
        return share


def _misfits(
    risen: NDArray[np.float64], here: NDArray[np.int64], changes: Collection[float], window: int
) -> tuple[NDArray[np.float64], float]:
    """Negative log likelihoods of the latest changes: of each place, and of unchanged light; 0 if too few are known."""
    if window < SMOOTHED_FRAMES:
        return np.zeros(len(here)), 0.0
    # Sums that would end after now have fewer changes, so that the newest change is in as many of them as any other.
    frames = np.minimum(np.arange(-window, SMOOTHED_FRAMES), 0)
    light = np.cumsum(list(itertools.islice(changes, len(changes) - window, None)))
    seen = _sums(np.append(0.0, light)[frames + window])
    foretold = _sums(risen.take(here[:, None] + frames, mode="clip"))
    unit = SMOOTHED_FRAMES * SCALE_STOPS
    return np.abs(foretold - seen).sum(axis=1) / unit, float(np.abs(seen).sum()) / unit


def _sums(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much light has risen in each `SMOOTHED_FRAMES` frames, along the last axis."""
    return light[..., SMOOTHED_FRAMES:] - light[..., :-SMOOTHED_FRAMES]


def _shifted(probability: float, evidence: float) -> float:
    """A probability after evidence, a log likelihood ratio."""
    log_odds = math.log(probability / (1.0 - probability)) + evidence
    return 0.5 * (1.0 + math.tanh(0.5 * log_odds))


REMEMBERED = 9
"""Intervals between frames, and delays. Their medians are right unless most frames are lost."""


@dataclass(slots=True)
class Cadence(Stateful):
    """The interval between frames, learnt from their stamps."""

    intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))  # the latest ones

    def frames(self, interval_s: float) -> int:
        """How many frames ago the frame before was, at least 1; `interval_s` is the time since then."""
        if interval_s <= 0.0:
            return 1
        self.intervals_s.append(interval_s)
        return max(round(interval_s / statistics.median(self.intervals_s)), 1)


USUAL_FRAMES = 2
"""Used until a first change has been seen to arrive."""

DISTINCT_STOPS = 0.15
"""A change of exposure too large to be rounding."""


@dataclass(slots=True)
class LoopDelay(Stateful):
    """The delay D of the loop, found by matching past targets with what frames were really taken with."""

    level: float | None = None  # level of the latest frame; None before the first
    found: deque[int] = field(default_factory=lambda: deque(maxlen=REMEMBERED))  # the latest delays that were found

    @property
    def frames(self) -> int:
        """D: 1 when the very next frame shows a decision. A median, since a lost frame on the way makes one wrong."""
        return round(statistics.median(self.found)) if self.found else USUAL_FRAMES

    def see(self, level: float, past_targets: Iterable[float]) -> None:
        """A frame taken at `level` (stops) has arrived: if the level is new, since when was it wanted?

        `past_targets` are the levels decided on, one per frame, oldest first; looked at only when the level is new.
        """
        changed = self.level is not None and abs(level - self.level) > DISTINCT_STOPS
        self.level = level
        if not changed:
            return
        targets = list(past_targets)
        for index in range(len(targets) - 1, 0, -1):
            agrees = abs(targets[index] - level) < DISTINCT_STOPS / 3
            if agrees and abs(targets[index - 1] - level) > DISTINCT_STOPS:
                self.found.append(len(targets) - index)
                return
