"""The photometric response function of a camera, and the grey levels that it predicts for other exposures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError

GREY_LEVELS = 256


@dataclass(frozen=True, slots=True, eq=False)
class ResponseFunction:
    """How grey levels follow from exposure: ``I = f(log2 of exposure)`` (Begin & Hunter 2022, eq. 16).

    Exposure is known up to a factor only, so the log2 exposures have an arbitrary offset. Raises ConfigurationError
    when the values are not those of a response function; the message begins with the key at fault.
    """

    # the inverse of f: log2 exposure (stops) of each grey level 0..255, float64, shape (256,), finite and non-
    # decreasing. Read-only
    log2_exposure: NDArray[np.float64]
    black_level: int  # the grey level without light. A pixel at or below it says only that there was little light
    saturation: int  # the grey level of a full pixel. A pixel at or above it says only that there was much light

    def __post_init__(self) -> None:
        curve = np.array(self.log2_exposure, dtype=np.float64)
        if curve.shape != (GREY_LEVELS,):
            raise ConfigurationError(f"log2_exposure has shape {curve.shape}: give 256 numbers, for grey 0 to 255")
        if not np.isfinite(curve).all():
            grey = int(np.flatnonzero(~np.isfinite(curve))[0])
            raise ConfigurationError(f"log2_exposure[{grey}] is {curve[grey]}: give a finite number of stops")
        if (np.diff(curve) < 0).any():
            grey = int(np.flatnonzero(np.diff(curve) < 0)[0]) + 1
            raise ConfigurationError(f"log2_exposure[{grey}] is below log2_exposure[{grey - 1}]: it must not decrease")
        if not 0 <= self.black_level < self.saturation < GREY_LEVELS:
            raise ConfigurationError(
                f"black_level {self.black_level} and saturation {self.saturation} must be grey levels of 0 to 255, "
                "the black level the lower one"
            )
        if curve[self.black_level] == curve[self.saturation]:
            raise ConfigurationError("log2_exposure does not rise from black_level to saturation: measure it again")
        curve.setflags(write=False)
        object.__setattr__(self, "log2_exposure", curve)

    @classmethod
    def linear(cls, black_level: int = 0) -> ResponseFunction:
        """The response of a sensor without gamma: grey above `black_level` (0..254) in proportion to exposure.

        The black level itself stands for half a grey level of light, since log2 of 0 is not finite.
        """
        signal = np.maximum(np.arange(GREY_LEVELS) - float(black_level), 0.5)
        return cls(np.log2(signal / signal[-1]), black_level, GREY_LEVELS - 1)

    def intensity(self, log2_exposure: NDArray[np.float64]) -> NDArray[np.float64]:
        """f: the grey level (float64, not rounded) at a log2 exposure (stops), within black level and saturation."""
        greys = np.arange(self.black_level, self.saturation + 1, dtype=np.float64)
        return np.asarray(np.interp(log2_exposure, self.log2_exposure[self.black_level : self.saturation + 1], greys))

    def inverse(self, grey: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """f^-1: log2 exposure (stops) of whole grey levels 0..255; those beyond black and saturation count as these."""
        bounded = np.clip(grey, self.black_level, self.saturation)
        return np.asarray(self.log2_exposure[bounded])

    def inverse_between(self, grey: NDArray[np.float64]) -> NDArray[np.float64]:
        """f^-1 (stops) of grey levels that need not be whole, straight between those that are."""
        levels = np.arange(GREY_LEVELS)
        return np.asarray(np.interp(grey, levels, self.inverse(levels)))

    def light(self, grey: NDArray[np.float64]) -> NDArray[np.float64]:
        """The light behind grey levels that need not be whole: 0 at black level, 1 at saturation, not beyond."""
        black, saturation = self.black_level, self.saturation
        greys = np.arange(black, saturation + 1, dtype=np.float64)
        light = np.exp2(self.log2_exposure[black : saturation + 1] - self.log2_exposure[saturation])
        light[0] = 0.0  # the curve says about half a grey level, since log2 of 0 is not finite
        return np.asarray(np.interp(grey, greys, light))


def greys_of_codes(codes: NDArray[Any], bit_depth: int) -> NDArray[np.float64]:
    """Grey levels, not whole ones, of the codes of a pixel with `bit_depth` bits (8 to 16).

    Control and calibration shift deeper codes to grey levels: a grey level is the middle of the codes that become it.
    """
    shift = bit_depth - 8
    return np.asarray((np.asarray(codes, np.float64) - ((1 << shift) - 1) / 2.0) / (1 << shift))


def prediction_table(response: ResponseFunction, delta_level: float) -> NDArray[np.uint8]:
    """``g_exp(I) = f(f^-1(I) + dE)`` for every grey level, uint8, shape (256,), non-decreasing.

    No change gives exactly the identity. Upwards, saturation is predicted exactly. Downwards, all saturated grey levels
    map to one: how much light there was above saturation is unknown, so whatever it hides stays a flat patch.

    Parameters
    ----------
    delta_level
        dE, the change of exposure level in stops.
    """
    greys = np.arange(GREY_LEVELS)
    if delta_level == 0:
        return greys.astype(np.uint8)
    return np.rint(response.intensity(response.inverse(greys) + delta_level)).astype(np.uint8)


def prediction_tables(response: ResponseFunction, delta_levels: Sequence[float]) -> NDArray[np.uint8]:
    """One `prediction_table` per change of level (stops): uint8, shape (n, 256)."""
    return np.stack([prediction_table(response, delta_level) for delta_level in delta_levels])
