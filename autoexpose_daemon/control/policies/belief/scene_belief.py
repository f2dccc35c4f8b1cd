"""What one camera knows of the light that its scene sends, whatever exposures showed it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.grounds import SceneHistogram
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast
from autoexpose_daemon.control.metrics.information import FRONT_END_DN, share_of_noise
from autoexpose_daemon.control.policies.belief.optics import Optics

Array = NDArray[np.float64]

BIN = 0.25
"""Stops of radiance in a bin."""

LOWEST, BINS = -45.0, 260
"""Log radiance of the first bin's lower bound, in stops from what saturates at level 0, and how many bins there are:
whatever a camera can expose for, from 20 us to seconds, and ten stops beyond either end."""

MEMORY_S = 10.0
"""Time constant with which what was seen is forgotten by a camera at rest."""

RENEWED = 0.2
"""Share of what was known of a bin's contrast that each frame showing that bin replaces."""

LONGEST_TAIL = 5.0
"""Stops: what is clipped continues what is seen beside it, the more slowly the more of it there is, up to this."""

NOTHING = 0.2
"""Probability that there is no contrast in what is clipped, before anything is known of a scene."""

FAINT = 0.05
"""Contrast that noise feigns in an empty region, as a share of what a rich one is expected to have."""

DETACHED = 2.5
"""Clipped mass that does not continue what is seen (a window, a lamp, a sky) may begin so many stops beyond it."""

DETACHED_TAIL = 1.5
"""Stops over which such mass is spread."""

UNLIKELY = 0.8
"""A wholly clipped picture shows nothing from this probability of `nothing` on."""

FROZEN_S = 0.2
"""A picture that repeats itself to the last pixel for so long is frozen."""

LEAST_LOOK = 0.1
"""Share of the contrast guessed in what is clipped that a frame must reveal to be a judgement of the guess."""

HALF_DETACHED_TAIL = 3.0
"""A tail of so many stops is as likely to be detached as to continue what is seen."""

BRIGHT_NEIGHBOURS, DARK_NEIGHBOURS = 1.0, 2.0
"""Stops inside of white, and of black, over which the neighbours of what is clipped are looked for."""

EDGES = LOWEST + BIN * np.arange(BINS + 1)
MIDDLES = EDGES[:-1] + BIN / 2
_SAMPLES = 4
"""Log exposures for which each bin stands."""


@dataclass(frozen=True, slots=True, eq=False)
class Hidden:
    """What is clipped on one side of what a frame shows.

    Attributes
    ----------
    bound
        Log radiance at which it begins, stops.
    side
        1 if it is brighter than that, -1 if darker.
    mass
        Pixels by cell of which nothing is known, shape (64,).
    tail
        Stops over which mass would fall off if it continued what is seen, by cell, shape (64,).
    richness
        What a pixel of it is expected to hold, by cell, shape (64,).
    """

    bound: float
    side: int
    mass: Array
    tail: Array
    richness: Array


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What frames at some levels are expected to hold, under each hypothesis about what is hidden; see `SceneBelief`.

    Attributes
    ----------
    probability
        Of each hypothesis, shape (h,); they sum to 1.
    of_cells
        Information of each cell of frames at each level, shape (h, 64, n).
    cells
        Which cells count, bool, shape (64,).
    revealed
        Share of what is hidden that such a frame would show, shape (h, n).
    """

    probability: Array
    of_cells: Array
    cells: NDArray[np.bool_]
    revealed: Array

    def information(self, favours: Array | None = None) -> Array:
        """Mean over the cells, as far as `favours`, shape (64,), weights them, shape (h, n)."""
        weights = self.cells * (1.0 if favours is None else favours)
        return np.asarray(weights @ self.of_cells / max(float(weights.sum()), 1e-9))

    def expected(self, favours: Array | None = None) -> Array:
        """The mean of that over the hypotheses, shape (n,)."""
        return self.probability @ self.information(favours)


class SceneBelief:
    """A histogram of the scene's radiance in 8x8 cells, with the contrast in each bin, that outlives exposures.

    A frame shows the part of it between black and white, and replaces what was believed of that part. Of what is
    clipped it tells how much there is; where that lies is remembered from frames that showed it, or guessed.
    Radiance is in stops from what saturates at level 0 in the present light.

    Attributes
    ----------
    mass
        Pixels by cell and bin, float64, shape (64, BINS).
    energy, precision
        Squared contrast per pixel (stops^2) times the precision with which it is known, and that precision.
    seen
        How surely each bin has been looked at, 0 to 1, shape (BINS,).
    drift
        Stops by which the light has risen beyond the bins' shifts, within half a bin.
    nothing
        Probability that there is no contrast in what is clipped: looks that found none have raised it.
    age_s
        Since the latest frame that was news.
    """

    STATE: ClassVar[tuple[str, ...]] = (
        "mass", "energy", "precision", "seen", "drift", "usual_richness", "nothing", "age_s", "latest", "hidden",
        "by_cell", "noise_share", "averaged", "relative_light",
    )  # fmt: skip
    mass: Array
    energy: Array
    precision: Array
    seen: Array
    drift: float
    usual_richness: float
    nothing: float
    age_s: float
    latest: Array | None
    hidden: list[Hidden]
    by_cell: Array
    noise_share: float
    averaged: float
    relative_light: Array

    def __init__(self, optics: Optics) -> None:
        self.optics = optics
        self.mass, self.energy, self.precision = np.zeros((3, CELLS * CELLS, BINS))
        self.seen = np.zeros(BINS)
        self.drift = 0.0
        self.usual_richness = 0.0
        self.nothing = NOTHING
        self.age_s = 0.0
        self.latest = None
        self.by_cell = np.zeros(CELLS * CELLS)
        self.noise_share = 1.0
        self.averaged = 1.0
        self.relative_light = np.ones(CELLS * CELLS)
        self.hidden = []

    def forget(self) -> None:
        """Know nothing any more."""
        for array in self._arrays:
            array[:] = 0.0
        self.hidden = []

    def pass_time(self, seconds: float, moved_cells: float, light_stops: float) -> None:
        """What was seen grows old: the camera has moved by so many cells, and the light has risen."""
        kept = np.exp(-seconds / MEMORY_S)
        self.energy *= kept
        self.precision *= kept
        self.seen *= kept
        self.nothing = NOTHING + kept * (self.nothing - NOTHING)
        self.age_s += seconds
        if moved_cells > 0:
            for array in (self.mass, self.energy, self.precision):
                _diffuse(array, moved_cells)
            self.energy *= 1.0 - moved_cells
            self.precision *= 1.0 - moved_cells
        self.drift += light_stops
        bins = round(self.drift / BIN)
        if bins:
            self.drift -= bins * BIN
            for array in self._arrays:
                _shift(array, bins)
            self.hidden = [replace(each, bound=each.bound + bins * BIN) for each in self.hidden]

    def is_news(self, seen: Contrast) -> bool:
        """Whether a frame differs from the one before, as by noise, or is all clipped."""
        repeated = self.latest is not None and np.array_equal(self.latest, seen.count)
        self.latest = seen.count
        return not repeated or not seen.count[:, 1:-1].any()

    def remark(self) -> str | None:
        """What is wrong with the camera, in words to follow "left camera"; None if it shows something."""
        if self.latest is None or (self.age_s == 0.0 and self.nothing < UNLIKELY):
            return None
        if self.latest[:, 1:-1].any():
            return "is frozen" if self.age_s > FROZEN_S else None
        if self.nothing < UNLIKELY:
            return None
        return "is white" if self.latest[:, -1].any() else "is black"

    def see(
        self, seen: Contrast, level: float, gain: float, averaged: float, relative_light: Array | None = None
    ) -> None:
        """Take in a frame.

        Parameters
        ----------
        seen
            Its gradients, by `Optics.bins`.
        level
            Its exposure level, stops.
        gain
            Its linear gain.
        averaged
            Samples of the sensor averaged into a pixel of it.
        relative_light
            What the lens lets through to each cell, shape (64,), with few distinct values; None: the same to all.
        """
        optics, self.averaged = self.optics, averaged
        self.relative_light = np.ones(CELLS * CELLS) if relative_light is None else relative_light
        level += self.drift
        noise = optics.noise_dn2(gain, averaged)
        readable = optics.readable
        weight, expected = seen.count @ readable, seen.count @ (noise * readable)
        self.by_cell = seen.count.sum(axis=1)
        self.noise_share = share_of_noise(seen.energy @ readable / 4, expected, weight, self.by_cell)
        signal = np.maximum(seen.energy / 4 - seen.count * (self.noise_share * noise), 0.0)
        inside = slice(1, -1)  # neither black nor saturated
        low, high = optics.low[inside] - level, optics.high[inside] - level
        overlap = np.minimum(high[:, None], EDGES[1:]) - np.maximum(low[:, None], EDGES[:-1])
        shares = np.maximum(overlap, 0.0) / (high - low)[:, None]
        mass = seen.count[:, inside] @ shares
        energy = (signal[:, inside] * optics.inverse_slope2[inside]) @ shares
        precise = (optics.slope2[inside] / (self.noise_share * noise[inside] + FRONT_END_DN**2)) ** 2
        precision = (seen.count[:, inside] * precise) @ shares
        black, saturated = optics.black - level, optics.saturated - level
        visible = np.clip(np.minimum(saturated, EDGES[1:]) - np.maximum(black, EDGES[:-1]), 0.0, None) / BIN
        self._judge_guess(visible, energy)
        self.age_s = 0.0
        self.mass += visible * (mass - self.mass)
        renewed = 1.0 - RENEWED * visible
        self.energy = renewed * self.energy + precision * energy / np.maximum(mass, 1e-9)
        self.precision = renewed * self.precision + precision
        self.seen = np.maximum(self.seen, visible)
        self._bound(black, saturated, seen.count[:, 0], seen.count[:, -1])

    def _judge_guess(self, visible: Array, found: Array) -> None:
        """Was there contrast where it was guessed, in what has not been looked at before?"""
        new = visible * (1.0 - self.seen)
        if not (self.hidden and new.any()):
            return
        guessed = sum(probability * energy.sum(axis=0) for probability, _, energy in self._guesses())
        total, expected = float(guessed.sum()), float(guessed @ new)
        if expected < LEAST_LOOK * total or total == 0.0:
            return
        share = float((found @ new).sum()) / expected
        # Exponential distributions of what is found, with the expected mean and with `FAINT` of it.
        evidence = math.log(FAINT) + share * (1.0 / FAINT - 1.0)
        odds = self.nothing / (1.0 - self.nothing) * math.exp(-min(evidence, 4.0) * expected / total)
        self.nothing = min(max(odds / (1.0 + odds), NOTHING / 4), 1.0 - FAINT**2)

    def _bound(self, black: float, saturated: float, below: Array, above: Array) -> None:
        """Keep no more mass beyond the bounds of what is visible than is clipped there, and ask where the rest is."""
        pixels, known = self.mass.sum(axis=1), np.asarray(self.mass * self._richness())
        if pixels.sum() > 0.05 * self.by_cell.sum() or not self.usual_richness:
            self.usual_richness = float(known.sum() / max(pixels.sum(), 1e-9)) or 0.05
        self.hidden = [
            self._hide(saturated, 1, above, BRIGHT_NEIGHBOURS, known),
            self._hide(black, -1, below, DARK_NEIGHBOURS, known),
        ]

    def _hide(self, bound: float, side: int, clipped: Array, neighbours: float, known: Array) -> Hidden:
        """What of the clipped mass is not remembered, and what is beside it in the picture."""
        beyond = side * (MIDDLES - bound)
        remembered = self.mass[:, beyond >= 0].sum(axis=1)
        self.mass[:, beyond >= 0] *= np.minimum(clipped / np.maximum(remembered, 1e-9), 1.0)[:, None]
        hidden = np.maximum(clipped - remembered, 0.0)
        beside = (beyond < 0) & (beyond > -neighbours)
        mass, energy = self.mass[:, beside].sum(axis=1), known[:, beside].sum(axis=1)
        density = (mass + 0.1 * mass.mean()) / neighbours
        tail = np.clip(hidden / np.maximum(density, 1e-9), 0.5, 50.0)
        usual = 0.02 * self.by_cell
        richness = (energy + usual * self.usual_richness) / np.maximum(mass + usual, 1e-9)
        return Hidden(bound, side, hidden, tail, richness)

    def outlook(self, levels: Array, gains: Array) -> Outlook:
        """What frames at these levels, and with these linear gains, are expected to hold.

        Information of a cell is the root of what its mean pixel holds.
        """
        of_light = [(self.relative_light == light, light) for light in np.unique(self.relative_light)]
        worths = [self._worth(levels, gains, light).T for _, light in of_light]
        visible, known = self._visible(levels), self.mass * self._richness()
        per_pixel = np.count_nonzero(self.by_cell) / max(float(self.by_cell.sum()), 1.0)
        guesses = list(self._guesses())
        probability, revealed = np.empty(len(guesses)), np.empty((len(guesses), levels.size))
        of_cells = np.empty((len(guesses), CELLS * CELLS, levels.size))
        for place, (probability[place], mass, energy) in enumerate(guesses):
            for (of, _), worth in zip(of_light, worths, strict=True):
                found = (known[of] + energy[of]) @ worth
                of_cells[place, of] = np.sqrt(np.maximum(found, 0.0) * per_pixel)
            revealed[place] = visible @ mass / max(float(mass.sum()), 1e-9)
        return Outlook(probability, of_cells, self.by_cell > 0, revealed)

    def _guesses(self) -> Iterator[tuple[float, Array, Array]]:
        """Hypotheses about what is hidden: probability, pixels by bin, and squared contrast by cell and bin."""
        continues = self._share_that_continues()
        mass, energy = self._placed(None)
        yield self.nothing, mass, np.zeros_like(energy)
        yield (1.0 - self.nothing) * continues, mass, energy
        yield (1.0 - self.nothing) * (1.0 - continues), *self._placed(DETACHED)

    def _share_that_continues(self) -> float:
        hidden = sum(float(each.mass.sum()) for each in self.hidden)
        if hidden == 0.0:
            return 1.0
        return sum(float((each.mass / (1.0 + each.tail / HALF_DETACHED_TAIL)).sum()) for each in self.hidden) / hidden

    def _placed(self, away: float | None) -> tuple[Array, Array]:
        """Mass by bin and energy by cell and bin, if what is hidden lies so many stops beyond; None: continues."""
        masses, energies = np.zeros(BINS), np.zeros_like(self.mass)
        for hidden in self.hidden:
            beyond = hidden.side * (MIDDLES - hidden.bound)
            tail = DETACHED_TAIL if away is not None else np.minimum(hidden.tail, LONGEST_TAIL)[:, None]
            likely = _falling(beyond - (away or 0.0), tail) * (1.0 - self.seen)
            likely = likely + 1e-9 * _falling(beyond, LONGEST_TAIL)  # it must be there, though all has been looked at
            likely = np.atleast_2d(likely)
            mass = hidden.mass[:, None] * likely / likely.sum(axis=1, keepdims=True)
            masses += mass.sum(axis=0)
            energies += mass * hidden.richness[:, None]
        return masses, energies

    def _worth(self, levels: Array, gains: Array, light: float) -> Array:
        """What a pixel's squared contrast is worth at these levels and gains, where the lens passes so much light.

        Shape (n, BINS).
        """
        within = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * BIN
        exposures = levels[:, None, None] + self.drift + EDGES[:-1, None] + within
        return np.asarray(self.optics.worth(exposures, gains, self.averaged, self.noise_share, light).mean(axis=2))

    def _visible(self, levels: Array) -> NDArray[np.bool_]:
        """Which bins are neither black nor saturated at these levels, shape (n, BINS)."""
        exposures = MIDDLES + levels[:, None] + self.drift
        return np.asarray((exposures > self.optics.black) & (exposures < self.optics.saturated))

    def _richness(self) -> Array:
        return self.energy / np.maximum(self.precision, 1e-12)

    @property
    def _arrays(self) -> tuple[Array, ...]:
        return self.mass, self.energy, self.precision, self.seen

    def histogram(self) -> SceneHistogram | None:
        """What is believed of the whole picture, for people to look at; None if nothing is."""
        pixels = float(self.by_cell.sum())
        if not self.hidden or not pixels:
            return None
        known, energy = self.mass.sum(axis=0), (self.mass * self._richness()).sum(axis=0)
        guessed = np.zeros(BINS)
        for probability, mass, its_energy in self._guesses():
            guessed += probability * mass
            energy += probability * its_energy.sum(axis=0)
        shares = known / pixels, guessed / pixels, energy / max(float(energy.sum()), 1e-12)
        known_share, guessed_share, contrast_share = (each.round(6).tolist() for each in shares)
        bounds = {each.side: each.bound + self.drift for each in self.hidden}
        start = LOWEST + self.drift
        return SceneHistogram(start, BIN, known_share, guessed_share, contrast_share, bounds[-1], bounds[1])


def _falling(beyond: NDArray[np.floating[Any]], tail: Array | float) -> Array:
    """Falls off exponentially beyond a bound, 0 on this side of it."""
    return np.asarray(np.where(beyond >= 0, np.exp(-np.maximum(beyond, 0.0) / tail), 0.0))


def _diffuse(array: Array, share: float) -> None:
    """Replace a share of each cell, shape (64, BINS), by the mean of its four neighbours."""
    cells = array.reshape(CELLS, CELLS, BINS)
    wide = np.pad(cells, ((1, 1), (1, 1), (0, 0)), "edge")
    around = (wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]) / 4
    cells += share * (around - cells)


def _shift(array: Array, bins: int) -> None:
    """Move what is known of each bin, shape (64, BINS), to one of more radiance."""
    array[:] = np.roll(array, bins, axis=-1)
    if bins > 0:
        array[..., :bins] = 0.0
    else:
        array[..., bins:] = 0.0
