"""The images of a calibration: one static scene, taken at many exposures, and which exposures those are."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.pixels import Pixels


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One image of a sweep and how it was taken."""

    # grey levels, shape (height, width), uint8 or uint16; the same pixels of the sensor in all shots of a sweep
    pixels: Pixels
    bit_depth: int  # significant bits of a pixel: 8, 12 or 16
    setting: ExposureSetting  # exposure time and gain that were really applied
    # when the exposure started (s), counted from anywhere; None for images from files, which do not say
    time_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Shots of a static scene in the order in which they were taken, all of one size and bit depth."""

    shots: tuple[Shot, ...]  # all of one gain
    # the same exposure times at a higher gain, which make two brightnesses of one; none if the scene has many
    brighter: tuple[Shot, ...] = ()


def mean_of(shots: Sequence[Shot], saturation: int) -> tuple[NDArray[np.float32], float]:
    """The mean of shots of one setting, in codes of their depth, and the share of samples at `saturation` (grey)."""
    mean = np.zeros(shots[0].pixels.shape, np.float32)
    clipped = 0.0
    for shot in shots:
        mean += shot.pixels
        clipped += float((shot.pixels >= saturation << (shot.bit_depth - 8)).mean()) / len(shots)
    return mean / np.float32(len(shots)), clipped


FIRST_TIME_US = 2000.0
LONGEST_TIME_US = 500_000.0
"""Darker scenes are not worth the wait: two passes at half a second already take most of a minute."""
FRAMES = 3
"""Frames of each exposure in each pass; in a row, so that flicker shows."""
STEP_STOPS = 0.5
MOST_EXPOSURES = 33
SEARCH_STOPS = 2.0
SEARCH_STEPS, SEARCH_FACTOR = 10, 8.0
NEARLY_ALL_PERCENT = 95
BLACK_GREY, WHITE_GREY = 6.0, 250.0
BRIGHTER_STOPS, LEAST_BRIGHTER_STOPS = 1.75, 1.5
"""How much more gain makes one brightness two; the least that does."""
STANDSTILL_GREY = 1.0
"""An image that changes by no more over `SEARCH_STOPS` is at its end, wherever the camera's black or white is."""
KEPT_PIXELS = 400_000
"""Plenty for a response, and a sweep of a large sensor fits into memory."""
OVERHEAD_S = 0.15
"""Time for writing a setting, and for frames that do not show it yet, in addition to the exposures."""


class StaticCamera(Protocol):
    """What a sweep needs from a camera on a tripod; see `calibration.session.Session`."""

    @property
    def limits(self) -> ExposureLimits:
        """The camera's own bounds."""

    def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
        """This many shots in a row, really taken with `setting`."""


@dataclass(frozen=True, slots=True)
class SweepPlan:
    """The settings of a sweep in the order in which they are taken, and the frames of each."""

    settings: tuple[ExposureSetting, ...]
    frames: int = FRAMES

    def seconds(self, setting: ExposureSetting) -> float:
        """About how long one setting takes (s): its frames, and those under way when it is written."""
        return OVERHEAD_S + (self.frames + 2) * setting.exposure_time_us * 1e-6

    def brighter(self, limits: ExposureLimits) -> SweepPlan | None:
        """The same exposure times at a higher gain; None if the camera has hardly more.

        Of one brightness, the grey levels lie between those that are seen without it.
        """
        first, second = self.settings[:2]
        step = second.level - first.level
        stops = max((round(BRIGHTER_STOPS / step - 0.5) + 0.5) * step, LEAST_BRIGHTER_STOPS)
        more_db = min(stops * DB_PER_STOP, limits.max_gain_db - first.gain_db)
        if more_db < LEAST_BRIGHTER_STOPS * DB_PER_STOP:
            return None
        gain_db = first.gain_db + more_db
        return replace(self, settings=tuple(replace(setting, gain_db=gain_db) for setting in self.settings))

    def run(self, camera: StaticCamera) -> Iterator[tuple[ExposureSetting, list[Shot]]]:
        """Take the sweep, setting by setting. Raises CameraError when the camera fails."""
        for setting in self.settings:
            yield setting, [_thinned(shot) for shot in camera.take(setting, self.frames)]


def plan_sweep(camera: StaticCamera, gain_db: float) -> SweepPlan:
    """Find the exposure times between which this scene goes from nearly all black to nearly all white.

    The plan takes them up and then down again: a drift shows as a difference between the two.
    """
    low_us, high_us = exposure_span_us(camera, gain_db)
    stops = math.log2(high_us / low_us)
    count = min(max(math.ceil(stops / STEP_STOPS) + 1, 2), MOST_EXPOSURES)
    up = [ExposureSetting(float(time_us), gain_db) for time_us in np.geomspace(low_us, high_us, count)]
    return SweepPlan((*up, *reversed(up)))


def exposure_span_us(camera: StaticCamera, gain_db: float) -> tuple[float, float]:
    """Exposure times (us) of a nearly all black and a nearly all white image, as far as the camera's bounds allow."""
    shortest_us, longest_us = time_bounds_us(camera.limits)
    start_us = min(max(FIRST_TIME_US, shortest_us), longest_us)
    start = _nearly_all(camera, start_us, gain_db)
    factor = 2.0**SEARCH_STOPS

    low_us, (_, bright) = start_us, start
    while bright > BLACK_GREY and low_us > shortest_us:
        low_us = max(low_us / factor, shortest_us)
        before, (_, bright) = bright, _nearly_all(camera, low_us, gain_db)
        if before - bright <= STANDSTILL_GREY and bright < WHITE_GREY / 2:
            break
    high_us, (dark, _) = start_us, start
    while dark < WHITE_GREY and high_us < longest_us:
        high_us = min(high_us * factor, longest_us)
        before, (dark, _) = dark, _nearly_all(camera, high_us, gain_db)
        if dark - before <= STANDSTILL_GREY and dark > WHITE_GREY / 2:
            break
    return low_us, high_us


def exposure_us_for(
    camera: StaticCamera,
    gain_db: float,
    *,
    percent: float,
    bright: tuple[float, float],
    white: float,
    first_us: float = FIRST_TIME_US,
) -> float:
    """The exposure time (us) at which a percentile of the pixels lies within `bright`, as near as the bounds allow.

    It is looked for from `first_us` on. Brightness counts in parts of full scale; from `white` on, an image shows that
    it is too bright, but not by how much. Raises CameraError when the camera fails.
    """
    shortest_us, longest_us = time_bounds_us(camera.limits)
    time_us = min(max(first_us, shortest_us), longest_us)
    for _ in range(SEARCH_STEPS):
        (shot,) = camera.take(ExposureSetting(time_us, gain_db), 1)
        part = float(np.percentile(shot.pixels, percent)) / (2**shot.bit_depth - 1)
        if bright[0] < part < bright[1]:
            break
        factor = min(sum(bright) / 2.0 / max(part, 1e-3), SEARCH_FACTOR) if part < white else 1.0 / SEARCH_FACTOR
        following_us = min(max(time_us * factor, shortest_us), longest_us)
        if following_us == time_us:
            break
        time_us = following_us
    return time_us


def time_bounds_us(limits: ExposureLimits) -> tuple[float, float]:
    """The range of exposure times (us) for a calibration: the camera's, as far as it is worth the wait."""
    return limits.min_time_us, max(min(limits.max_time_us, LONGEST_TIME_US), limits.min_time_us)


def _nearly_all(camera: StaticCamera, time_us: float, gain_db: float) -> tuple[float, float]:
    """Grey levels of 0 to 255 that nearly all pixels are above, and below."""
    (shot,) = camera.take(ExposureSetting(time_us, gain_db), 1)
    ends = np.percentile(_thinned(shot).pixels, [100 - NEARLY_ALL_PERCENT, NEARLY_ALL_PERCENT])
    dark, bright = ends / 2.0 ** (shot.bit_depth - 8)
    return float(dark), float(bright)


def _thinned(shot: Shot) -> Shot:
    """Every n-th row and column of a large image."""
    step = math.ceil(math.sqrt(shot.pixels.size / KEPT_PIXELS))
    return shot if step == 1 else replace(shot, pixels=shot.pixels[::step, ::step].copy())
