"""What the C extension computes for the policy `belief`, written down with numpy: the oracle of its tests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast
from autoexpose_daemon.control.picture.steering import STEERING_SHARE
from autoexpose_daemon.control.policies.belief.policy import (
    BRIGHTNESS_LOSS,
    HOPE,
    LEAST_CAMERA,
    LOST_BELOW,
    LOST_COST,
    Prospects,
)
from autoexpose_daemon.control.policies.belief.scene_belief import (
    BIN,
    BINS,
    BRIGHT_NEIGHBOURS,
    DARK_NEIGHBOURS,
    DETACHED,
    DETACHED_TAIL,
    HALF_DETACHED_TAIL,
    LONGEST_TAIL,
    LOWEST,
    MEMORY_S,
    NOTHING,
    RENEWED,
    UNSURE,
    Optics,
    Outlook,
    SceneBelief,
)
from evaluation.stage.oracle import FRONT_END_DN, share_of_noise, variance_of

Array = NDArray[np.float64]

EDGES = LOWEST + BIN * np.arange(BINS + 1)
MIDDLES = EDGES[:-1] + BIN / 2
SAMPLES = 4
"""Log exposures for which each bin stands."""

DARK, BRIGHT = 0, 1


class NumpyBelief(SceneBelief):
    """A `SceneBelief` that does without the extension; its arrays are by cell and bin, shape (64, BINS)."""

    def __init__(self, optics: Optics) -> None:
        super().__init__(optics)
        self.mass, self.energy, self.precision = np.zeros((3, CELLS * CELLS, BINS))

    def pass_time(self, seconds: float, moved_cells: float, light_stops: float) -> None:
        kept = np.exp(-seconds / MEMORY_S)
        self.energy *= kept
        self.precision *= kept
        self.seen *= kept * (1.0 - moved_cells / CELLS)
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
            for array in (self.mass, self.energy, self.precision, self.seen):
                _shift(array, bins)
            self.bounds += bins * BIN

    def see(
        self, seen: Contrast, level: float, gain: float, averaged: float, relative_light: Array | None = None
    ) -> None:
        self.averaged = averaged
        if seen.count[:, 1:-1].any():
            self.age_s = 0.0
        self.relative_light = np.ones(CELLS * CELLS) if relative_light is None else relative_light
        level += self.drift
        readable, lows, highs, slope2, inverse_slope2, shot, read = self.optics.by_bin
        noise = variance_of(shot * gain + read * gain**2, averaged)
        weight, expected = seen.count @ readable, seen.count @ (noise * readable)
        self.by_cell = seen.count.sum(axis=1)
        self.noise_share = share_of_noise(seen.energy @ readable / 4, expected, weight, self.by_cell)
        signal = np.maximum(seen.energy / 4 - seen.count * (self.noise_share * noise), 0.0)
        inside = slice(1, -1)  # neither black nor saturated
        low, high = lows[inside] - level, highs[inside] - level
        overlap = np.minimum(high[:, None], EDGES[1:]) - np.maximum(low[:, None], EDGES[:-1])
        shares = np.maximum(overlap, 0.0) / (high - low)[:, None]
        mass = seen.count[:, inside] @ shares
        energy = (signal[:, inside] * inverse_slope2[inside]) @ shares
        precise = (slope2[inside] / (self.noise_share * noise[inside] + FRONT_END_DN**2)) ** 2
        precision = (seen.count[:, inside] * precise) @ shares
        black, saturated = _clipping(self.optics) - level
        visible = np.clip(np.minimum(saturated, EDGES[1:]) - np.maximum(black, EDGES[:-1]), 0.0, None) / BIN
        self._judge(visible, energy)
        self.mass += visible * (mass - self.mass)
        renewed = 1.0 - RENEWED * visible
        self.energy = renewed * self.energy + precision * energy / np.maximum(mass, 1e-9)
        self.precision = renewed * self.precision + precision
        self.seen = np.maximum(self.seen, visible)
        self._bound(black, saturated, seen.count[:, 0], seen.count[:, -1])

    def look_out(self, levels: Array, gains: Array, favours: Array | None, outlook: Outlook) -> None:
        of_light = [(self.relative_light == light, light) for light in np.unique(self.relative_light)]
        worths = [self._worth(levels, gains, light).T for _, light in of_light]
        visible, known = self._visible(levels), self.mass * self._richness()
        per_pixel = np.count_nonzero(self.by_cell) / max(float(self.by_cell.sum()), 1.0)
        cells = (self.by_cell > 0).astype(np.float64)
        for place, (outlook.probability[place], mass, energy) in enumerate(self._guesses()):
            of_cells = np.empty((CELLS * CELLS, levels.size))
            for (of, _), worth in zip(of_light, worths, strict=True):
                of_cells[of] = np.sqrt(np.maximum((known[of] + energy[of]) @ worth, 0.0) * per_pixel)
            outlook.information[place] = _mean(of_cells, cells)
            outlook.favoured[place] = _mean(of_cells, cells * (1.0 if favours is None else favours.ravel()))
            outlook.revealed[place] = visible @ mass / max(float(mass.sum()), 1e-9)

    def _judge(self, visible: Array, found: Array) -> None:
        new = visible * (1.0 - self.seen)
        if not (self.hidden.any() and new.any()):
            return
        guessed = sum(probability * energy.sum(axis=0) for probability, _, energy in self._guesses())
        something = 1.0 - self.nothing
        self._judge_guess(
            float(guessed.sum()) / something, float(guessed @ new) / something, float((found @ new).sum())
        )

    def _bound(self, black: float, saturated: float, below: Array, above: Array) -> None:
        """Keep no more mass beyond the bounds of what is visible than is clipped there, and ask where the rest is."""
        sure = self.mass * self.precision / (self.precision + UNSURE * self.usual_richness**-2)
        if sure.sum() > 0.05 * self.by_cell.sum():
            self.usual_richness = max(float((sure * self._richness()).sum() / sure.sum()), 1e-3)
        known = self.mass * self._richness()
        self.bounds = np.array([black, saturated])
        self._hide(BRIGHT, above, BRIGHT_NEIGHBOURS, known)
        self._hide(DARK, below, DARK_NEIGHBOURS, known)

    def _hide(self, side: int, clipped: Array, neighbours: float, known: Array) -> None:
        """What of the clipped mass is not remembered, and what is beside it in the picture."""
        beyond = self._beyond(side)
        remembered = self.mass[:, beyond >= 0].sum(axis=1)
        self.mass[:, beyond >= 0] *= np.minimum(clipped / np.maximum(remembered, 1e-9), 1.0)[:, None]
        beside = (beyond < 0) & (beyond > -neighbours)
        mass, energy = self.mass[:, beside].sum(axis=1), known[:, beside].sum(axis=1)
        density = (mass + 0.1 * mass.mean()) / neighbours
        usual = 0.02 * self.by_cell
        self.hidden[side] = np.maximum(clipped - remembered, 0.0)
        self.tail[side] = np.clip(self.hidden[side] / np.maximum(density, 1e-9), 0.5, 50.0)
        self.richness[side] = (energy + usual * self.usual_richness) / np.maximum(mass + usual, 1e-9)

    def _beyond(self, side: int) -> Array:
        """How far each bin lies beyond a bound, stops."""
        return (1 if side == BRIGHT else -1) * (MIDDLES - self.bounds[side])

    def _guesses(self) -> Iterator[tuple[float, Array, Array]]:
        """Hypotheses about what is hidden: probability, pixels by bin, and squared contrast by cell and bin."""
        pixels = float(self.hidden.sum())
        continues = float((self.hidden / (1.0 + self.tail / HALF_DETACHED_TAIL)).sum()) / pixels if pixels else 1.0
        mass, energy = self._placed(None)
        yield self.nothing, mass, np.zeros_like(energy)
        yield (1.0 - self.nothing) * continues, mass, energy
        for away in DETACHED:
            yield (1.0 - self.nothing) * (1.0 - continues) / len(DETACHED), *self._placed(away)

    def _placed(self, away: float | None) -> tuple[Array, Array]:
        """Mass by bin and energy by cell and bin, if what is hidden lies so many stops beyond; None: continues."""
        masses, energies = np.zeros(BINS), np.zeros_like(self.mass)
        for side in (DARK, BRIGHT):
            if not self.hidden[side].any():
                continue
            beyond = self._beyond(side)
            tail = DETACHED_TAIL if away is not None else np.minimum(self.tail[side], LONGEST_TAIL)[:, None]
            likely = _falling(beyond - (away or 0.0), tail) * (1.0 - self.seen)
            likely = likely + 1e-9 * _falling(beyond, LONGEST_TAIL)  # it must be there, though all has been looked at
            likely = np.atleast_2d(likely)
            mass = self.hidden[side][:, None] * likely / likely.sum(axis=1, keepdims=True)
            masses += mass.sum(axis=0)
            energies += mass * self.richness[side][:, None]
        return masses, energies

    def _worth(self, levels: Array, gains: Array, light: float) -> Array:
        """What a pixel's squared contrast is worth at these levels and gains, where the lens passes so much light.

        Squared slope over the variance of noise and front end; consumers divide the light of the lens out, which scales
        contrast and noise alike. Shape (n, BINS).
        """
        within = (np.arange(SAMPLES) + 0.5) / SAMPLES * BIN
        exposures = levels[:, None, None] + self.drift + EDGES[:-1, None] + within
        _, _, first, step = self.optics.tables
        slope2, shot, read = self.optics.by_exposure
        places = np.rint(exposures / step).astype(np.int64) - first
        seen = (places >= 0) & (places < slope2.size)
        places = np.clip(places, 0, slope2.size - 1)
        gain = gains[:, None, None]
        noise = self.noise_share * variance_of(shot[places] * gain + read[places] * gain**2, self.averaged)
        worth = np.where(seen, slope2[places], 0.0) / (noise + (light * FRONT_END_DN) ** 2)
        return np.asarray(worth.mean(axis=2))

    def _visible(self, levels: Array) -> NDArray[np.bool_]:
        """Which bins are wholly between black and saturated at these levels, shape (n, BINS)."""
        exposures, (black, saturated) = MIDDLES + levels[:, None] + self.drift, _clipping(self.optics)
        return np.asarray((exposures >= black + BIN / 2) & (exposures < saturated - BIN / 2))

    def _richness(self) -> Array:
        unsure = UNSURE * self.usual_richness**-2
        return (self.energy + unsure * self.usual_richness) / (self.precision + unsure)


def weigh_levels(
    information: Array,
    favoured: Array | None,
    revealed: Array,
    probability: Array,
    *,
    votes: Array,
    sharp: Array,
    served: float,
) -> tuple[Array, Array]:
    """What levels are worth to all cameras in the present light, and for what they would reveal, both of shape (n,)."""
    shares, best = _shares_of_best(information, probability, sharp, votes)
    worth = shares.sum(axis=0)
    now = int(worth.argmax())
    look = np.zeros(sharp.size)
    cameras = zip(sharp * information, probability, revealed, votes, shares, best, strict=True)
    for of_camera, chances, shown, vote, share, one in cameras:
        hoped = of_camera[0] + HOPE * (of_camera - of_camera[0])
        if_right = worth - share + vote * hoped / np.maximum(hoped.max(axis=1), one)[:, None]
        gained = if_right.max(axis=1) - if_right[:, now]
        look += (chances * gained) @ shown
    if favoured is not None:
        afforded = worth > (1.0 - STEERING_SHARE) * worth.max()
        worth = np.where(afforded, _shares_of_best(favoured, probability, sharp, votes)[0].sum(axis=0), 0.0)
    return worth, served * look


def _shares_of_best(information: Array, probability: Array, sharp: Array, votes: Array) -> tuple[Array, Array]:
    """What each camera expects of levels, (cameras, n), as shares of its best; and what counts as that, (cameras,)."""
    expected = sharp * np.einsum("ch,chn->cn", probability, information)
    best = expected.max(axis=1)
    best = np.maximum(best, max(LEAST_CAMERA * best.max(), 1e-9))
    return votes[:, None] * expected / best[:, None], best


def plan_values(prospects: Prospects) -> tuple[Array, Array]:
    """What `Prospects.values` says of each level that can be taken."""
    inside = slice(prospects.beyond, prospects.levels.size - prospects.beyond)
    levels = prospects.levels[inside]
    shown = levels + prospects.light[:, 1:, None]
    worths = np.tensordot(prospects.chances, np.interp(shown, prospects.levels, prospects.worth), 1)
    looks = prospects.chances @ np.interp(shown[:, 0], prospects.levels, prospects.look)
    light = prospects.chances @ prospects.light
    brightness = levels + light[1:, None]
    later = np.zeros(levels.size)
    for frame in range(len(worths) - 1, 0, -1):
        change = np.abs(brightness[frame] - brightness[frame - 1][:, None])
        later = (_of_pairs(worths[frame], change) + later).max(axis=1)
    change = np.abs(brightness[0] - (prospects.before + light[0]))
    return np.asarray(_of_pairs(worths[0], change) + later + looks), looks


def _of_pairs(worth: Array, change: Array) -> Array:
    left = worth * np.exp(-BRIGHTNESS_LOSS * change)
    return np.asarray(left - LOST_COST * np.maximum(1.0 - left / LOST_BELOW, 0.0))


def _clipping(optics: Optics) -> Array:
    """Log exposures below and above which a pixel is clipped."""
    return optics.by_bin[1, [1, -1]]


def _mean(of_cells: Array, weights: Array) -> Array:
    return np.asarray(weights @ of_cells / max(float(weights.sum()), 1e-9))


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
