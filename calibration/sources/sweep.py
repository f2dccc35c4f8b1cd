"""The images of a calibration: one static scene, taken at many exposures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imaging.exposure import ExposureSetting
from imaging.pixels import Pixels


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One image of a sweep and how it was taken.

    Attributes
    ----------
    pixels
        Grey levels, shape (height, width), uint8 or uint16; the same pixels of the sensor in all shots of a sweep.
    bit_depth
        Significant bits of a pixel: 8, 12 or 16.
    setting
        Exposure time and gain that were really applied.
    time_s
        When the exposure started (s), counted from anywhere; None for images from files, which do not say.
    """

    pixels: Pixels
    bit_depth: int
    setting: ExposureSetting
    time_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Shots of a static scene in the order in which they were taken, all of one size and bit depth.

    Attributes
    ----------
    shots
        All of one gain.
    brighter
        The same exposure times at a higher gain, which make two brightnesses of one; none if the scene has many.
    """

    shots: tuple[Shot, ...]
    brighter: tuple[Shot, ...] = ()


def mean_of(shots: Sequence[Shot], saturation: int) -> tuple[NDArray[np.float32], float]:
    """The mean of shots of one setting, in codes of their depth, and the share of samples at `saturation` (grey)."""
    mean = np.zeros(shots[0].pixels.shape, np.float32)
    clipped = 0.0
    for shot in shots:
        mean += shot.pixels
        clipped += float((shot.pixels >= saturation << (shot.bit_depth - 8)).mean()) / len(shots)
    return mean / np.float32(len(shots)), clipped
