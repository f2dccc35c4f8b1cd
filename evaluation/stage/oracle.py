"""The best exposure of a frame, found by trying: what policies are measured against, by Fisher information."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from autoexpose_daemon.control.balance import Balance, ExposurePriority
from autoexpose_daemon.control.metrics.contrast import Contrast, GreyBins, SensorNoise, contrast, response_slopes
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.policy import Objective
from evaluation.arrays import Floats, Ints
from evaluation.stage.camera import LIMITS, Image, time_first
from evaluation.stage.rendering import Stage
from imaging.exposure import ExposureSetting, linear_gain
from imaging.frames import CameraName
from imaging.python310 import exp2
from imaging.response import GREY_LEVELS, ResponseFunction

# Grey levels of contrast that feature detectors and matchers lose besides noise, as the default policy has it.
FRONT_END_DN = 6.0
QUANTISATION = 1 / 12  # Variance of rounding to whole grey levels
FLATTEST_SHARE = 0.1  # The flattest tenth of the cells shows how much noise there is at most
# Cells count there with so much of their weight neither black nor saturated, and with so much noise expected (squared
# grey levels): what is clipped shows no noise, and rounding hides less than half a grey level of it.
LEAST_READABLE, LEAST_VARIANCE = 0.5, 0.25


class Information:
    """The information of frames that are not blurred.

    The mean over 8x8 cells of the root of ``sum |grad I|^2 / (var(I) + q^2)``, the precision with which the cell could
    be aligned, by its mean pixel; because of the root, one bright patch cannot outweigh the rest. var is the variance
    from shot noise, read noise and quantisation, q is `FRONT_END_DN`. What noise adds to the gradients is subtracted
    first, and saturated pixels count nothing.

    `noise`: noise of its sensor; None: the configuration's default.

    `bins`: those of the response, by which gradients are to be collected."""

    def __init__(self, response: ResponseFunction, noise: SensorNoise | None = None) -> None:
        greys, self.bins = np.arange(GREY_LEVELS), GreyBins(response)
        if noise is None:
            parameters = ControlParameters()
            noise = SensorNoise(parameters.full_well_e, parameters.read_noise_e)
        readable = (greys > self.bins.black) & (greys < self.bins.saturated)
        stops = response.inverse(greys)
        factors = noise.variance_factors(response_slopes(response), np.exp2(stops - stops[response.saturation]))
        of_bin = self.bins.of == np.arange(self.bins.count)[:, None]
        mean = of_bin / of_bin.sum(axis=1, keepdims=True)
        # By bin: share of readable greys, shot and read noise.
        self._readable, self._shot, self._read = mean @ readable, *(mean @ each for each in factors)

    def measure(self, seen: Contrast, pixels: float, gain: float) -> float:
        """Of an image whose gradients, by `bins`, are given; 0 for one without gradients. `pixels`: how many pixels of
        the sensor were averaged into one of the image."""
        noise = variance_of(self._shot * gain + self._read * gain**2, pixels)
        weights = np.stack([self._readable, noise * self._readable, np.ones_like(noise)], axis=1)
        weight, expected, by_cell = (seen.count @ weights).T
        noise *= share_of_noise(seen.energy @ self._readable / 4, expected, weight, by_cell)
        of_cells = (seen.energy / 4 - seen.count * noise) @ (self._readable / (noise + FRONT_END_DN**2))
        cells = max(int(np.count_nonzero(by_cell)), 1)
        mean_pixel = cells / max(float(by_cell.sum()), 1.0)
        return float(np.sqrt(np.maximum(of_cells, 0.0) * mean_pixel).sum() / cells)


def share_of_noise(shown: Floats, expected: Floats, weight: Floats, by_cell: Floats) -> float:
    """The actual noise as a share of the noise expected, at most 1: the flattest cells have no more. A sensor better
    than the one configured would otherwise seem to see nothing in the dark. By cell: energy shown, expected, and weight
    of readable pixels, and of all."""
    telling = (weight > LEAST_READABLE * by_cell) & (expected > LEAST_VARIANCE * weight)
    if not telling.any():
        return 1.0
    return min(float(np.quantile(shown[telling] / expected[telling], FLATTEST_SHARE)), 1.0)


def variance_of(noise_dn2: Floats, pixels: float) -> Floats:
    """Variance of the image that control sees, each pixel of which is the rounded mean of `pixels` of the sensor's.
    `noise_dn2` is the variance from photons and read noise in a frame before rounding; all in squared grey levels."""
    averaged = (noise_dn2 + QUANTISATION) / pixels
    return averaged + QUANTISATION if pixels > 1 else averaged


GRID_STOPS = 0.125
LEVELS = np.arange(LIMITS.darkest.level, LIMITS.brightest.level + GRID_STOPS / 2, GRID_STOPS)  # The levels tried
COARSE = 3  # Every third level is tried first: 0.375 stops apart, while plateaus are 0.5 to 3.5 stops wide
PROMISING = 0.85  # Hills of the coarse curve that reach this share of its maximum are searched on the full grid
PLATEAU = 0.99  # The best level is the middle of those that reach this share of the maximum
# For the best time and gain of all: at each level the time that is at most one of these, the rest gain.
LONGEST_TIMES_US = LIMITS.max_time_us * 0.5 ** np.arange(6)


@dataclass(frozen=True, slots=True)
class Best:
    """The best exposure of one frame."""

    level: float  # the best exposure level (stops)
    metrics: tuple[float, ...]  # the largest value of each judged camera, at its own best level
    # The largest mean, over the judged cameras, of their shares of `metrics`. One exposure serves both, so with two
    # cameras even the best one stays below 1.
    joint: float


class Oracle:
    """Finds the best exposure of the stage's present frame, for any way of splitting it into time and gain.

    Frames are judged as the control loop does: its preparation (area average, 3x3 median) and gradient information
    with delta 0.30; or, before the median, their Fisher information, as a linear camera with the configuration's
    default noise. Answers are kept for the frame, so policies that split alike share them. To that end, motion is
    rounded to half octaves, which changes the best metric by less than 1 %.

    `objective`: what is maximised. `exhaustive`: try all levels, with the exact motion."""

    def __init__(
        self,
        stage: Stage,
        cameras: tuple[CameraName, ...] = ("left",),
        objective: Objective = "metric",
        *,
        exhaustive: bool = False,
    ) -> None:
        self._stage, self._sides, self._exhaustive = stage, cameras, exhaustive
        self._value = self._metric_of if objective == "metric" else self._information_of
        self._preparation = ImagePreparation()
        self._metric = GradientMetric(delta=0.30)
        self._information = Information(ResponseFunction.linear())
        self._frame = -1
        self._known: dict[tuple[ExposureSetting, ...], Best] = {}
        self._values: dict[ExposureSetting, tuple[float, ...]] = {}

    def judge(self, setting: ExposureSetting) -> tuple[float, ...]:
        """Value of each judged camera's image when the present frame is taken with a setting."""
        return tuple(self._value(self._stage.expose(camera, setting), setting) for camera in self._sides)

    def _metric_of(self, image: Image, setting: ExposureSetting) -> float:
        return self._metric.measure(self._preparation.prepare(image))

    def _information_of(self, image: Image, setting: ExposureSetting) -> float:
        pixels = image.size / self._preparation.prepare(image).size
        seen = contrast(self._preparation.unfiltered, self._information.bins)
        return self._information.measure(seen, pixels, linear_gain(setting.gain_db))

    def best(self, balance: Balance, motion_px: float) -> Best | None:
        """The best exposure of the present frame split by `balance`; None when no exposure shows any gradient."""
        self._forget_other_frames()
        motion_px = motion_px if self._exhaustive else rounded_motion(motion_px)
        settings = tuple(
            LIMITS.realise(float(level), balance.exposure_time_us(float(level), motion_px, LIMITS)) for level in LEVELS
        )
        if settings not in self._known:
            self._known[settings] = _best(*self._search(settings))
        best = self._known[settings]
        return best if best.joint > 0 else None

    def best_of_all(self) -> Best | None:
        """The best exposure of the present frame however it is split; None when no exposure shows any gradient."""
        self._forget_other_frames()
        searched = [
            self._search(tuple(LIMITS.realise(level, min(exp2(level), longest_us)) for level in LEVELS.tolist()))
            for longest_us in LONGEST_TIMES_US.tolist()
        ]
        levels, curves = (np.concatenate(parts) for parts in zip(*searched, strict=True))
        best = _best(levels, curves)
        return best if best.joint > 0 else None

    def _forget_other_frames(self) -> None:
        if self._frame != self._stage.frame:
            self._frame = self._stage.frame
            self._known.clear()
            self._values.clear()

    def _search(self, settings: tuple[ExposureSetting, ...]) -> tuple[Floats, Floats]:
        """The levels tried, (n,), and what each camera's image is worth there, (n, cameras)."""
        curve = np.full((len(LEVELS), len(self._sides)), np.nan)
        coarse = np.arange(0, len(LEVELS), 1 if self._exhaustive else COARSE)
        self._try(settings, curve, coarse)
        if not self._exhaustive:
            hills = [_hills(values[coarse]) for values in curve.T]
            hills.append(_hills(_joint(curve[coarse])))
            for hill in coarse[np.unique(np.concatenate(hills))]:
                self._try(settings, curve, np.arange(max(hill - COARSE + 1, 0), min(hill + COARSE, len(LEVELS))))
        tried = np.flatnonzero(~np.isnan(curve[:, 0]))
        return LEVELS[tried], curve[tried]

    def _try(self, settings: tuple[ExposureSetting, ...], curve: Floats, places: Ints) -> None:
        for place in places:
            setting = settings[place]
            if setting not in self._values:
                self._values[setting] = self.judge(setting)
            curve[place] = self._values[setting]


def best_start(oracle: Oracle) -> ExposureSetting:
    """The best setting of the present frame, time before gain, from which all entrants start."""
    best = oracle.best(ExposurePriority(), 0.0)
    return time_first(LIMITS.brightest.level if best is None else best.level)


def rounded_motion(motion_px: float) -> float:
    """Speed of image points rounded to half octaves; less than half a pixel counts as none."""
    return 0.0 if motion_px < 0.5 else 2.0 ** (round(2.0 * math.log2(motion_px)) / 2.0)


def _best(levels: Floats, curve: Floats) -> Best:
    joint = _joint(curve)
    good = levels[joint >= PLATEAU * joint.max()]
    return Best(float(good.mean()), tuple(curve.max(axis=0).tolist()), float(joint.max()))


def _hills(values: Floats) -> Ints:
    """Indices of the local maxima that reach `PROMISING` of the largest."""
    padded = np.concatenate([[-1.0], values, [-1.0]])
    highest = (values >= padded[:-2]) & (values >= padded[2:]) & (values >= PROMISING * values.max()) & (values > 0)
    return np.flatnonzero(highest)


def _joint(curve: Floats) -> Floats:
    """Mean over the cameras of their shares of their own best, shape (levels,)."""
    best = curve.max(axis=0)
    return np.asarray(np.mean(curve / np.where(best > 0, best, 1.0), axis=1))
