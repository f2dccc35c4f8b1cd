"""By how much less light reaches one camera than another, from looks of both at one evenly lit wall."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.sweep import StaticCamera, exposure_us_for, mean_of
from documents.bounds import OFFSET_STOPS
from imaging.exposure import ExposureSetting
from imaging.pixels import Layout, Pixels, light_samples
from imaging.response import ResponseFunction, greys_of_codes

Array = NDArray[np.float64]

FRAMES = 8
"""Frames of a look: their differences show noise and flicker."""
MIDDLE = (0.4, 0.6)
"""Parts of full scale that the median is exposed to: about the same for all cameras, so that a black level that no
response file tells of, or a bend of the response, is much the same error in each."""
CENTRE = 3
"""One part in three of the picture, each way: in the corners lenses differ."""
CELLS = (4, 4)
MOST_CLIPPED = 0.01
LEAST_LIGHT = 0.05
UNEVEN_STOPS, TOO_UNEVEN_STOPS = 0.2, 0.6
"""By how much parts of the centre may differ, which depends on where each camera looks: warned of, refused."""
UNSTEADY_STOPS, TOO_UNSTEADY_STOPS = 0.05, 0.15
"""By how much the frames of a look, or the two looks of a camera, may differ: warned of, refused. The median of 8 bits
has steps of up to 0.025 stops."""
LEAST_ERROR_STOPS = 0.02
"""Half a grey level of each camera, and what they round exposure times by without saying so."""
SIGMAS = 2.0


def centre(pixels: Pixels, layout: Layout) -> Pixels:
    """The samples of light in the centre of a frame."""
    samples = light_samples(pixels, layout)
    height, width = samples.shape[:2]
    return samples[height // CENTRE : height - height // CENTRE, width // CENTRE : width - width // CENTRE]


@dataclass(frozen=True, slots=True, eq=False)
class WallLook:
    """What a camera sees of the wall in some frames."""

    setting: ExposureSetting  # that they were taken with
    light: Array  # the median of each frame, as a share of the light that saturates, shape (frames,)
    clipped: float  # share of the samples that are saturated
    uneven_stops: float  # by how much parts of the picture differ; infinite if one is black

    @property
    def stops(self) -> Array:
        """The light of each frame without its exposure, log2, counted from anywhere; of light that is not black."""
        return np.asarray(np.log2(self.light) - self.setting.level)


Looks = tuple[WallLook, WallLook]
"""The looks of a camera: one there, and one back, with the others in between."""


def look_at_wall(camera: StaticCamera, response: ResponseFunction, setting: ExposureSetting | None = None) -> WallLook:
    """A look with `setting`, or with one that exposes the median to the middle of the range.

    The camera's shots are of its `centre`. Raises CameraError when it fails.
    """
    if setting is None:
        gain_db = camera.limits.min_gain_db
        time_us = exposure_us_for(camera, gain_db, percent=50, bright=MIDDLE, white=0.9)
        setting = ExposureSetting(time_us, gain_db)
    shots = camera.take(setting, FRAMES)
    depth = shots[0].bit_depth
    mean, clipped = mean_of(shots, response.saturation)
    medians = np.array([np.median(shot.pixels) for shot in shots])
    cells = response.light(greys_of_codes(cv2.resize(mean, CELLS, interpolation=cv2.INTER_AREA), depth))
    uneven_stops = math.log2(cells.max() / cells.min()) if cells.min() > 0 else math.inf
    return WallLook(shots[0].setting, response.light(greys_of_codes(medians, depth)), clipped, uneven_stops)


def judge_looks(looks: Looks) -> Iterator[Finding]:
    """What is wrong with what a camera saw."""
    if max(look.clipped for look in looks) > MOST_CLIPPED:
        text = "the wall is saturated, or a part of it: use dimmer light, and keep lamps and reflections out"
        yield Finding("refused", "clipped", text)
        return
    darkest = float(min(look.light.min() for look in looks))
    if darkest < LEAST_LIGHT:
        text = f"the wall is {darkest:.1%} of full scale bright at the longest exposure time: use brighter light"
        yield Finding("refused", "too_dark", text)
        return
    apart = _apart_stops(looks)
    if apart > UNSTEADY_STOPS:
        text = (
            f"frames of one exposure differ by {apart:.2f} stops: use light that neither changes nor flickers, let "
            "lamps warm up, and keep out of the picture"
        )
        yield Finding("refused" if apart > TOO_UNSTEADY_STOPS else "warned", "unsteady", text)
    uneven = max(look.uneven_stops for look in looks)
    if uneven > UNEVEN_STOPS:
        text = (
            f"the centre of the picture differs from part to part by {uneven:.2f} stops: show all cameras the same "
            "part of a plain, evenly lit wall"
        )
        yield Finding("refused" if uneven > TOO_UNEVEN_STOPS else "warned", "uneven", text)


def _apart_stops(looks: Looks) -> float:
    """By how much the frames of a look differ, or those of the two."""
    stops = [look.stops for look in looks]
    return float(max(*map(np.ptp, stops), abs(stops[0].mean() - stops[1].mean())))


@dataclass(frozen=True, slots=True)
class Offset:
    """By how many stops less light reaches a camera than the reference."""

    stops: float
    # how far it may be from the truth: half the difference between the ways there and back, two standard errors of the
    # frames, and what is rounded
    error_stops: float


def solve_offset(reference: Looks, camera: Looks) -> Offset:
    """The offset of a camera from looks that were not refused; light that changes steadily cancels."""
    there, back = (one.stops.mean() - other.stops.mean() for one, other in zip(reference, camera, strict=True))
    variance = sum(float(look.stops.var(ddof=1)) / look.stops.size for look in (*reference, *camera)) / 4.0
    error_stops = LEAST_ERROR_STOPS + abs(there - back) / 2.0 + SIGMAS * math.sqrt(variance)
    return Offset(float(there + back) / 2.0, float(error_stops))


def judge_offset(offset: Offset, gain_is_driven: bool) -> Iterator[Finding]:
    """Whether the camera can make up for it."""
    if offset.stops not in OFFSET_STOPS:
        text = f"an offset of {offset.stops:.1f} stops is beyond {OFFSET_STOPS}: is a lens cap or a wrong filter on?"
        yield Finding("refused", "out_of_range", text)
    if not gain_is_driven:
        text = "its gain is not driven, so that it cannot make up for an offset: autoexpose calibrate gain, first"
        yield Finding("refused", "no_gain", text)
