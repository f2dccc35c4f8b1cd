"""The noise of a sweep as a second witness of its response, which knows nothing of exposure times.

Light arrives in photons: in the light that the true response finds behind grey levels, variance is read noise plus
light times a constant (EMVA 1288). If wrong exposure times make the response find ``light ** (1 / p)`` instead, it is
``a * found ** (2 - 2 p) + b * found ** (2 - p)``.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.noise.photon_transfer import grey_step, pairs_of
from calibration.sweep import Shot, Sweep
from imaging.response import GREY_LEVELS, ResponseFunction

MOST_CORRELATION = 0.03
"""Between neighbouring pixels: photons arrive at each by itself; smoothing and compression spread their noise."""
PARTS = 5
"""Of the range of light, each of which must be free of it: compression spares large noise."""
GROUPS = 100
"""Groups of pixels alike in brightness."""
MOST_PIXELS = 60_000
"""Taken from each image; more would give variances better than a curve of whole grey levels is known."""
MOST_PAIRS = 40
LEAST_PIXELS = 60
LEAST_POINTS = 20
"""Variances needed for a verdict."""
LEAST_RANGE_STOPS = 1.5
"""The range of light over which those must lie."""
LEAST_SIGMA_STEPS = 0.6
"""Noise that makes rounding to grey levels as good as random; its variance is then 1/12 of a step squared."""
CLEAR_SIGMAS = 5.0
DARK_GREY = 4.0
"""Grey levels above black below which a response of whole grey levels is too coarse."""
SMALL_NOISE = 0.25
"""Share of the light; where noise is larger, the curve bends within it."""
SYSTEMATIC = 0.02
"""Relative error of a variance apart from chance."""
ROUNDS = 3
"""Rounds of choosing variances by a fit, and fitting those chosen."""
POWERS = np.linspace(0.7, 1.6, 91)
"""Those tried. Below, read noise and photons grow alike, and their sum explains any noise."""
DOUBTFUL, SURE = 9.0, 25.0
"""By how much chi squared falls where a power is preferred to 1, and surely so: three and five standard errors."""
SAME_POWER = 0.03
"""A power this near to 1 is as good."""
REFUSED_POWER = 0.08
"""Real sensors come near: pixels that share out their charge when nearly full show up to a tenth less variance."""
REFUSED_MISFIT = 8.0
"""Chi squared for each variance, from which no power saves the response."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NoiseWitness:
    """What the noise says about a response."""

    power: float  # the found light to this power is the light that the noise implies; 1: they agree
    doubted: bool  # whether the power is hardly 1
    misfit: float  # chi squared for each variance, with the power 1
    # the light (saturation is 1) whose shot noise would explain all noise that may be there without light (two standard
    # errors more than is found): exposures that are longer than stated can hide at most this much
    dark_light: float
    sure: bool = False  # whether the power is surely not 1
    # that of the noise of neighbouring pixels, where it is largest: if it is not 0, something has changed the noise
    # since the photons arrived, so that it is no evidence of light
    correlation: float = 0.0

    @property
    def photons(self) -> bool:
        """Whether the noise can be that of photons."""
        return self.correlation < MOST_CORRELATION

    @property
    def finding(self) -> Finding | None:
        """What to report if the noise contradicts the response."""
        if self.misfit > REFUSED_MISFIT or (self.sure and abs(self.power - 1.0) > REFUSED_POWER):
            text = (
                "the noise of the images contradicts the response: it does not grow with the light that the response "
                "finds, as that of photons must; exposure times are not in proportion to light, or the gain changed"
            )
            return Finding("refused", "noise_disagrees", text)
        if self.doubted:
            text = (
                f"by the noise of the images, light grows as the power {self.power:.2f} of what the response finds: "
                "check that exposure times are in proportion to light"
            )
            return Finding("warned", "noise_disagrees", text)
        return None


def hear_noise(sweep: Sweep, response: ResponseFunction) -> NoiseWitness | None:
    """What the noise says of a response; None if there is too little noise, or range of light, to say anything."""
    points = _large(_points(sweep, response))
    if len(points.variance) < LEAST_POINTS or np.ptp(np.log2(points.lights)) < LEAST_RANGE_STOPS:
        return None
    expected = points.of_power(1.0, *_fit(points, points.variance, 1.0)[1:])
    fits = [_fit(points, expected, power) for power in POWERS]
    sizes = np.array([size for size, _, _ in fits])
    best, straight = int(np.argmin(sizes)), int(np.argmin(np.abs(POWERS - 1.0)))
    power = float(POWERS[best])
    scale = max(float(sizes[best]) / len(expected), 1.0)
    fall = float(sizes[straight] - sizes[best]) / scale if abs(power - 1.0) > SAME_POWER else 0.0
    _, dark, slope = fits[straight]
    most_dark = dark + 2.0 * _dark_error(points, expected)
    misfit, dark_light = float(sizes[straight]) / len(expected), most_dark / max(slope, 1e-12)
    return NoiseWitness(power, fall > DOUBTFUL, misfit, dark_light, fall > SURE, _correlation(points))


def _correlation(points: _Points) -> float:
    """The largest correlation of neighbouring pixels over parts of the range of light."""
    light = np.log2(points.lights.mean(axis=0))
    part = np.minimum((light - light.min()) / np.ptp(light) * PARTS, PARTS - 1).astype(np.intp)
    weights = np.bincount(part, points.degrees)
    means = np.bincount(part, points.correlation * points.degrees) / np.maximum(weights, 1.0)
    return float(np.max(np.abs(means) - 3.0 / np.sqrt(np.maximum(weights, 1.0))))


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Variances of the difference in radiance of two shots, within groups of pixels alike in brightness."""

    # lights, exposures, steps: of both shots, shape (2, n): the light of the group (saturation is 1), the exposure by
    # which it is divided for the radiance, and the light between two grey levels
    lights: Array
    exposures: Array
    steps: Array
    variance: Array  # shape (n,), that of rounding taken out
    degrees: Array  # its degrees of freedom
    correlation: Array  # of the differences of neighbouring pixels, shape (n,)

    def of_power(self, power: float, dark: float, slope: float) -> Array:
        """The variances under a power, with these amounts of read noise and of photons."""
        return np.asarray(self.basis(power) @ [dark, slope])

    def basis(self, power: float) -> Array:
        """The variances of read noise and of photons under a power, for amounts of 1, shape (n, 2)."""
        exponents = (2.0 - 2.0 * power, 2.0 - power)
        return np.stack([(self.lights**each / self.exposures**2).sum(axis=0) for each in exponents], axis=1)

    def part(self, kept: NDArray[np.bool_]) -> _Points:
        """Some of them."""
        return _Points(*(getattr(self, field.name)[..., kept] for field in fields(self)))


def _large(points: _Points) -> _Points:
    """Points where a fit expects enough noise to make rounding random; by their own size, chance would choose them."""
    kept = points.part(points.variance > LEAST_SIGMA_STEPS**2 * ((points.steps / points.exposures) ** 2).sum(axis=0))
    for _ in range(ROUNDS):
        if len(kept.variance) < LEAST_POINTS:
            break
        _, dark, slope = _fit(kept, kept.variance, 1.0)
        noise = np.sqrt(dark + slope * points.lights)
        enough = (noise > LEAST_SIGMA_STEPS * points.steps) & (noise < SMALL_NOISE * points.lights)
        kept = points.part(np.logical_and(*enough))
    return kept


def _fit(points: _Points, expected: Array, power: float) -> tuple[float, float, float]:
    """Chi squared, and the amounts of read noise and photons (neither negative), by least squares under a power."""
    weights = _weights(points, expected)
    basis, variance, root = points.basis(power), points.variance, np.sqrt(weights)
    found = np.linalg.lstsq(basis * root[:, None], variance * root)[0]
    if (found < 0.0).any():
        alone = np.maximum((weights * variance) @ basis / (weights @ basis**2), 0.0)
        misses = [float(weights @ (variance - basis[:, i] * alone[i]) ** 2) for i in range(2)]
        found = np.where(np.arange(2) == int(np.argmin(misses)), alone, 0.0)
    return float(weights @ (variance - basis @ found) ** 2), float(found[0]), float(found[1])


def _weights(points: _Points, expected: Array) -> Array:
    return np.asarray(1.0 / (np.maximum(expected, 1e-30) ** 2 * (2.0 / points.degrees + SYSTEMATIC**2)))


def _dark_error(points: _Points, expected: Array) -> float:
    """The standard error of the amount of read noise."""
    basis, weights = points.basis(1.0), _weights(points, expected)
    return float(np.sqrt(np.linalg.pinv(basis.T @ (basis * weights[:, None]), hermitian=True)[0, 0]))


def _pairs(sweep: Sweep) -> list[tuple[int, int]]:
    """Shots to compare: neighbours of one setting; where nothing is repeated, neighbouring exposures."""
    pairs = pairs_of(sweep.shots)
    if not pairs:
        order = [int(k) for k in np.argsort([shot.setting.level for shot in sweep.shots], kind="stable")]
        pairs = list(pairwise(order))
    return pairs[:: -(-len(pairs) // MOST_PAIRS)]


def _points(sweep: Sweep, response: ResponseFunction) -> _Points:
    """All groups in all pairs of shots whose pixels are clear of black and saturation.

    Pixels are grouped by their mean over the sweep, in which the noise of a single shot hardly shows.
    """
    stride = -(-sweep.shots[0].pixels.size // MOST_PIXELS)
    pixels = [shot.pixels[::stride].ravel() for shot in sweep.shots]  # whole rows, whose neighbours stay neighbours
    longest = max(shot.setting.level for shot in sweep.shots)
    group = _groups(np.mean(pixels, axis=0, dtype=np.float32))
    count = np.maximum(np.bincount(group, minlength=GROUPS), 1)
    scale = _LightScale.of(sweep.shots[0], response, grey_step(sweep.shots))

    def mean(values: NDArray[np.generic]) -> Array:
        return np.asarray(np.bincount(group, np.asarray(values, np.float64), GROUPS) / count)

    parts = []
    for pair in _pairs(sweep):
        lights = [
            scale.light.take(pixels[k], mode="clip") for k in pair
        ]  # a code may have more bits than its camera said
        exposures = [float(np.exp2(sweep.shots[k].setting.level - longest)) for k in pair]
        greys = [mean(pixels[k]) for k in pair]
        steps = np.array([scale.step * scale.slope(grey) for grey in greys])
        difference = lights[0] / exposures[0] - lights[1] / exposures[1]
        noise = difference - mean(difference)[group]
        variance = mean(noise**2) * count / np.maximum(count - 1, 1)
        scaled = noise / np.sqrt(np.maximum(variance, 1e-30))[group]
        correlation = mean(scaled * np.roll(scaled, 1))
        columns = np.repeat(np.array(exposures)[:, None], GROUPS, axis=1)
        variance -= ((steps / columns) ** 2).sum(axis=0) / 12.0
        clear = count >= LEAST_PIXELS
        for k, grey in zip(pair, greys, strict=True):
            spread = CLEAR_SIGMAS * np.sqrt(mean((pixels[k] - grey[group]) ** 2))
            clear &= (grey - spread > scale.black) & (grey + spread < scale.saturation)
        parts.append(
            _Points(
                np.stack([mean(light) for light in lights]), columns, steps, variance, count - 1.0, correlation
            ).part(clear)
        )
    return _Points(*(np.concatenate([getattr(p, each.name) for p in parts], axis=-1) for each in fields(_Points)))


def _groups(means: NDArray[np.float32]) -> NDArray[np.intp]:
    """Which group each pixel belongs to, all about equally large."""
    group = np.empty(len(means), np.intp)
    group[np.argsort(means, kind="stable")] = np.arange(len(means)) * GROUPS // len(means)
    return group


@dataclass(frozen=True, slots=True, eq=False)
class _LightScale:
    """The light (saturation is 1) of each code of a pixel, as a response finds it, and the range where it does."""

    light: Array
    step: int
    black: float
    saturation: float

    @classmethod
    def of(cls, shot: Shot, response: ResponseFunction, step: int) -> _LightScale:
        per_grey = 2.0 ** (shot.bit_depth - 8)
        middle = (per_grey - 1.0) / 2.0
        codes = np.arange(GREY_LEVELS * per_grey, dtype=np.float64)
        stops = response.inverse_between((codes - middle) / per_grey) - response.log2_exposure[response.saturation]
        black, saturation = response.black_level * per_grey + middle, response.saturation * per_grey
        return cls(np.exp2(stops), step, black + DARK_GREY * per_grey, saturation)

    def slope(self, code: Array) -> Array:
        """Light per code."""
        low = np.clip(code.astype(np.intp) - self.step, 0, len(self.light) - 1 - 2 * self.step)
        return np.asarray((self.light[low + 2 * self.step] - self.light[low]) / (2 * self.step))
