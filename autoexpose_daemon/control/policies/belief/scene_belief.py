"""What one camera's scene is believed to be, and what its frames would show of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import SceneHistogram
from autoexpose_daemon.control.metrics import extension as _native
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, GreyBins, SensorNoise, response_slopes
from autoexpose_daemon.control.snapshot import Stateful
from imaging.response import GREY_LEVELS, ResponseFunction

Array = NDArray[np.float64]

DARK_DN = 2
"""Grey levels above black that count as black: rounding and noise leave hardly anything of how much light there was."""

_STEP = 1 / 32
"""Stops between the log exposures that are tabulated."""

_BLACKEST = -2.0
"""Stops that the lowest bin of grey levels is taken to reach below its upper bound: black has no lower one."""


class Optics:
    """What a camera shows of radiance that reaches it with log exposure x: stops, 0 at saturation."""

    def __init__(self, response: ResponseFunction, noise: SensorNoise) -> None:
        self.bins = GreyBins(response, DARK_DN)  # by which gradients are to be collected
        greys = np.arange(GREY_LEVELS)
        full = float(response.inverse(np.array([response.saturation]))[0])
        exposures, slopes = response.inverse(greys) - full, response_slopes(response)
        shot, read = noise.variance_factors(slopes, np.exp2(exposures))
        of_bin = self.bins.of == np.arange(self.bins.count)[:, None]
        mean = of_bin / of_bin.sum(axis=1, keepdims=True)
        readable = (greys > self.bins.black) & (greys < self.bins.saturated)
        edges = np.interp(np.arange(GREY_LEVELS + 1) - 0.5, greys, exposures)
        edges[0] = edges[1] + _BLACKEST
        begin = np.array([int(greys_of.argmax()) for greys_of in of_bin])
        low, high = edges[begin], edges[np.append(begin[1:], GREY_LEVELS)]
        # Share of each bin's grey levels that are neither black nor saturated; log exposures between which they lie;
        # mean squared slope of the response (grey levels per stop), and of its inverse; shot and read noise.
        self.by_bin: Array = np.stack(
            [mean @ readable, low, high, mean @ slopes**2, mean @ (1.0 / slopes**2), mean @ shot, mean @ read]
        )
        black, saturated = float(low[1]), float(low[-1])
        self.first = math.floor(black / _STEP)
        tabulated = _STEP * np.arange(self.first, math.ceil(saturated / _STEP) + 1, dtype=np.float64)
        shown = response.intensity(tabulated + full)
        visible = (tabulated > black) & (tabulated < saturated)
        slope2 = np.where(visible, np.interp(shown, greys, slopes) ** 2, 0.0)
        # Squared slope where a pixel is not clipped, else 0; shot and read noise: at log exposures `_STEP` apart, from
        # the `first` such step on.
        self.by_exposure: Array = np.stack([slope2, np.interp(shown, greys, shot), np.interp(shown, greys, read)])

    @property
    def tables(self) -> tuple[Array, Array, int, float]:
        """For the C extension."""
        return self.by_bin, self.by_exposure, self.first, _STEP


BIN = 0.25
"""Stops of radiance in a bin."""

LOWEST, BINS = -45.0, 260
"""Log radiance of the first bin's lower bound, in stops from what saturates at level 0, and how many bins there are:
whatever a camera can expose for, from 20 us to seconds, and ten stops beyond either end."""

MEMORY_S = 10.0
"""Time constant with which what was seen is forgotten by a camera at rest."""

RENEWED = 0.2
"""Share of what was known of a bin's contrast that each frame showing that bin replaces."""

RICHNESS = 0.05
"""Squared contrast of a pixel, stops^2, before anything is known of a scene."""

UNSURE = 1e-3
"""Precision, in units of 1 / usual^2, with which a bin is expected to have the usual contrast: frames in which it is
nearly black tell less."""

LONGEST_TAIL = 5.0
"""Stops: what is clipped continues what is seen beside it, the more slowly the more of it there is, up to this."""

NOTHING = 0.2
"""Probability that there is no contrast in what is clipped, before anything is known of a scene."""

FAINT = 0.05
"""Contrast that noise feigns in an empty region, as a share of what a rich one is expected to have."""

DETACHED = (0.25, 3.0)
"""Clipped mass that does not continue what is seen (a window, a lamp, a sky) may begin so many stops beyond it. In 256
views of panoramas, well exposed or a stop brighter, half of what was white lay within 0.75 stop, a tenth beyond 4."""

DETACHED_TAIL = 1.5
"""Stops over which such mass is spread."""

SILENT_S = 0.3
"""A camera that shows nothing new, its picture all clipped or the same to the last pixel, loses its vote with this time
constant, and is faulty after it, unless no camera shows anything."""

LEAST_LOOK = 0.1
"""Share of the contrast guessed in what is clipped that a frame must reveal to be a judgement of the guess."""

HALF_DETACHED_TAIL = 6.0
"""A tail of so many stops is as likely to be detached as to continue what is seen."""

BRIGHT_NEIGHBOURS, DARK_NEIGHBOURS = 1.0, 2.0
"""Stops inside of white, and of black, over which the neighbours of what is clipped are looked for."""

RULES = (
    LOWEST, BIN, RENEWED, UNSURE, LEAST_LOOK, LONGEST_TAIL, DETACHED, DETACHED_TAIL, HALF_DETACHED_TAIL,
    DARK_NEIGHBOURS, BRIGHT_NEIGHBOURS,
)  # fmt: skip
"""For the C extension."""


_EVEN_LIGHT = np.ones(CELLS * CELLS)

HYPOTHESES = 2 + len(DETACHED)
"""About what is hidden: there is no contrast in it, it continues what is seen beside it, it is detached from that."""


class Outlook(NamedTuple):
    """What frames at some levels are expected to hold, under each hypothesis; see `SceneBelief`."""

    probability: Array  # of each hypothesis, shape (4,); they sum to 1
    information: Array  # mean over the cells of the root of what a cell's mean pixel holds, at each level, shape (4, n)
    favoured: Array  # the same with the cells as favours weight them; undefined without favours
    revealed: Array  # share of what is hidden that such a frame would show, shape (4, n)

    @classmethod
    def of_levels(cls, count: int) -> Outlook:
        """One to be filled."""
        return cls(np.empty(HYPOTHESES), *np.empty((3, HYPOTHESES, count)))


class SceneBelief(Stateful):
    """A histogram of the scene's radiance in 8x8 cells, with the contrast in each bin, that outlives exposures.

    A frame shows the part of it between black and white, and replaces what was believed of that part. Of what is
    clipped it tells how much there is; where that lies is remembered from frames that showed it, or guessed.
    Radiance is in stops from what saturates at level 0 in the present light.
    """

    mass: Array  # pixels by bin and cell, float64, shape (BINS, 64)
    # squared contrast per pixel (stops^2) times the precision with which it is known, and that precision
    energy: Array
    precision: Array
    seen: Array  # how surely each bin has been looked at, 0 to 1, shape (BINS,)
    bounds: Array  # log radiance of black and of white in the latest frame, stops, shape (2,)
    # of what is beyond these two and not remembered: pixels by cell; stops over which it would fall off if it continued
    # what is seen; and what a pixel of it is expected to hold, shape (2, 64)
    hidden: Array
    tail: Array
    richness: Array
    drift: float = 0.0  # stops by which the light has risen beyond the bins' shifts, within half a bin
    usual_richness: float = RICHNESS
    # probability that there is no contrast in what is clipped: looks that found none have raised it
    nothing: float = NOTHING
    age_s: float = 0.0  # since the latest frame that showed something new
    latest: Array | None = None
    by_cell: Array
    noise_share: float = 1.0
    averaged: float = 1.0
    relative_light: Array

    def __init__(self, optics: Optics) -> None:
        self.optics = optics
        self.mass, self.energy, self.precision = np.zeros((3, BINS, CELLS * CELLS))
        self.seen, self.bounds = np.zeros(BINS), np.zeros(2)
        self.hidden, self.tail, self.richness = np.zeros((3, 2, CELLS * CELLS))
        self.by_cell = np.zeros(CELLS * CELLS)
        self.relative_light = _EVEN_LIGHT

    def forget(self) -> None:
        """Know nothing any more."""
        for array in (self.mass, self.energy, self.precision, self.seen, self.hidden):
            array[:] = 0.0

    def pass_time(self, seconds: float, moved_cells: float, light_stops: float) -> None:
        """What was seen grows old: the camera has moved by so many cells, and the light has risen."""
        kept = math.exp(-seconds / MEMORY_S)
        self.nothing = NOTHING + kept * (self.nothing - NOTHING)
        self.age_s += seconds
        self.drift += light_stops
        bins = round(self.drift / BIN)
        self.drift -= bins * BIN
        self.bounds += bins * BIN
        _native.pass_time(self._scene, kept, moved_cells, bins)

    def is_news(self, seen: Contrast) -> bool:
        """Whether a frame differs from the one before, as by noise, or is all clipped."""
        repeated = self.latest is not None and np.array_equal(self.latest, seen.count)
        return not repeated or not shows(seen.count)

    def why_uncounted(self) -> str | None:
        """What is wrong with the camera, in words to follow "left camera"; None if it shows something."""
        if self.latest is None or self.age_s < SILENT_S:
            return None
        if shows(self.latest):
            return "shows the same image at any exposure, not counted"
        return f"is {'white' if self.latest[:, -1].any() else 'black'} at any exposure, not counted"

    def see(
        self, seen: Contrast, level: float, gain: float, averaged: float, relative_light: Array | None = None
    ) -> None:
        """Take in the gradients of a frame, by `Optics.bins`; its exposure level (stops) and linear gain.

        `averaged` samples of the sensor went into each pixel, and the lens lets `relative_light` through to each cell:
        shape (64,), with few distinct values; None: the same to all.
        """
        self.latest = seen.count
        self.averaged = averaged
        if shows(seen.count):
            self.age_s = 0.0
        self.relative_light = _EVEN_LIGHT if relative_light is None else relative_light
        self.noise_share, self.usual_richness, *guess = _native.see_frame(
            RULES, self._scene, self.optics.tables, seen.energy, seen.count, level + self.drift, gain, averaged,
            self.by_cell,
        )  # fmt: skip
        self._judge_guess(*guess)

    def _judge_guess(self, guessed: float, expected: float, found: float) -> None:
        """Was there contrast where it was guessed, in what has not been looked at before?"""
        if expected < LEAST_LOOK * guessed or guessed == 0.0:
            return
        share = found / ((1.0 - self.nothing) * expected)
        # Exponential distributions of what is found, with the expected mean and with `FAINT` of it.
        evidence = math.log(FAINT) + share * (1.0 / FAINT - 1.0)
        odds = self.nothing / (1.0 - self.nothing) * math.exp(-min(evidence, 4.0) * expected / guessed)
        self.nothing = min(max(odds / (1.0 + odds), NOTHING / 4), 1.0 - FAINT**2)

    def look_out(self, levels: Array, gains: Array, favours: Array | None, outlook: Outlook) -> None:
        """Write what frames at these levels, with these linear gains, are expected to hold.

        Favours weight the cells, shape (64,).
        """
        continues = _native.look_out(
            RULES, self._scene, self.optics.tables, levels + self.drift, gains, self.averaged, self.noise_share,
            self.by_cell, self.relative_light, favours, outlook.information, outlook.favoured, outlook.revealed,
        )  # fmt: skip
        outlook.probability[0] = self.nothing
        something = 1.0 - self.nothing
        outlook.probability[1] = something * continues
        outlook.probability[2:] = something * (1.0 - continues) / len(DETACHED)

    @property
    def _scene(self) -> tuple[Array | float, ...]:
        return (
            self.mass, self.energy, self.precision, self.seen, self.bounds, self.hidden, self.tail, self.richness,
            self.usual_richness,
        )  # fmt: skip

    def histogram(self) -> SceneHistogram | None:
        """What is believed of the whole picture, for people to look at; None if nothing is."""
        if not (pixels := float(self.by_cell.sum())):
            return None
        known, contrast, guessed, guessed_contrast = np.empty((4, BINS))
        _native.sum_light(RULES, self._scene, known, contrast, guessed, guessed_contrast)
        contrast += (1.0 - self.nothing) * guessed_contrast
        shares = known / pixels, guessed / pixels, contrast / max(float(contrast.sum()), 1e-12)
        known_share, guessed_share, contrast_share = (each.round(6).tolist() for each in shares)
        start, (black, white) = LOWEST + self.drift, (self.bounds + self.drift).tolist()
        return SceneHistogram(start, BIN, known_share, guessed_share, contrast_share, black, white)


def shows(count: Array) -> bool:
    """Whether any pixel is neither black nor saturated."""
    return bool(count[:, 1:-1].any())
