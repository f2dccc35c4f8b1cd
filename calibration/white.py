"""White balance: by how much a camera must amplify each colour so that a grey surface is grey, and whether it does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.sweep import Shot, mean_of
from imaging.response import ResponseFunction, greys_of_codes

Array = NDArray[np.float64]
Ratios = dict[str, float]

COLOURS = ("Red", "Green", "Blue")
"""Named as the entries of BalanceRatioSelector."""
CELLS = (6, 8)
MOST_CLIPPED = 1e-3
LEAST_LIGHT = 0.1
GOOD_SPREAD, USABLE_SPREAD = 0.03, 0.08
"""By how much parts of the surface may differ in colour."""
GOOD_OFF, USABLE_OFF = 0.01, 0.05
"""By how much colours may still differ once they are amplified."""
LEAST_ERROR = 0.001
DECIMALS = 4


@dataclass(frozen=True, slots=True, eq=False)
class GreySurface:
    """What a camera sees of a grey surface."""

    light: Array  # mean light of red, green and blue, as shares of what saturates, shape (3,)
    cells: Array  # the same by cell, shape (rows, columns, 3)
    clipped: float  # share of the samples that are saturated

    @property
    def spread(self) -> float:
        """By how much red or blue over green differs from cell to cell, as a share, at most."""
        ratios = self.cells[..., (0, 2)] / np.maximum(self.cells[..., 1:2], 1e-9)
        return float(np.abs(ratios / np.maximum(ratios.mean(axis=(0, 1)), 1e-9) - 1.0).max())

    @property
    def uncertainty(self) -> float:
        """Standard error of red or blue over green, as a share, from how much cells differ."""
        ratios = self.cells[..., (0, 2)] / np.maximum(self.cells[..., 1:2], 1e-9)
        relative = ratios / np.maximum(ratios.mean(axis=(0, 1)), 1e-9)
        return float((relative.std(axis=(0, 1)) / np.sqrt(ratios[..., 0].size)).max())

    @property
    def off(self) -> float:
        """By how much the colours differ from grey, as a share, at most."""
        return float(np.abs(self.light / self.light.mean() - 1.0).max())


def grey_surface(shots: Sequence[Shot], response: ResponseFunction) -> GreySurface:
    """What shots with pixels of shape (height, width, 3), red, green and blue, show."""
    mean, clipped = mean_of(shots, response.saturation)
    codes = cv2.resize(mean, CELLS[::-1], interpolation=cv2.INTER_AREA)
    light = response.light(greys_of_codes(codes, shots[0].bit_depth))
    return GreySurface(light.mean(axis=(0, 1)), light, clipped)


def ratios_for(seen: GreySurface, offered: Sequence[str]) -> Ratios:
    """What to set for each colour that the camera offers, so that the weaker ones become as bright as the strongest.

    If the camera does not offer green, they become as bright as green: then a ratio may be below 1.
    """
    reference = seen.light.max() if "Green" in offered else seen.light[1]
    wanted = dict(zip(COLOURS, reference / seen.light, strict=True))
    return {colour: round(float(wanted[colour]), DECIMALS) for colour in COLOURS if colour in offered}


def judge_surface(seen: GreySurface) -> Iterator[Finding]:
    """What is wrong with the surface, or with its light."""
    if seen.clipped > MOST_CLIPPED:
        text = f"{seen.clipped:.1%} of the samples are saturated: use dimmer light, and keep reflections out"
        yield Finding("refused", "clipped", text)
    elif seen.light.min() <= 0 or seen.light.max() < LEAST_LIGHT:
        text = f"the surface is {max(seen.light.max(), 0):.0%} of full scale bright: use brighter light"
        yield Finding("refused", "too_dark", text)
    elif seen.spread > GOOD_SPREAD:
        text = (
            f"parts of the surface differ in colour by {seen.spread:.0%}: show a grey or white card that fills "
            "the picture, or name its place with --box"
        )
        yield Finding("refused" if seen.spread > USABLE_SPREAD else "warned", "not_grey", text)


def judge_ratios(ratios: Ratios, bounds: Mapping[str, tuple[float, float]]) -> Iterator[Finding]:
    """Whether the camera takes the ratios, and they hide no saturation."""
    for colour, ratio in ratios.items():
        low, high = bounds[colour]
        if not low <= ratio <= high:
            text = (
                f"{colour.lower()} needs a ratio of {ratio:.2f}, and the camera takes {low:g} to {high:g}: use light "
                "that has more of that colour"
            )
            yield Finding("refused", "out_of_range", text)
        elif ratio < 1.0 - USABLE_OFF:
            text = (
                f"{colour.lower()} needs a ratio of {ratio:.2f}: below 1 a saturated pixel no longer looks saturated, "
                "and this camera cannot amplify green instead: use light that has more green"
            )
            yield Finding("refused", "below_1", text)


def judge_balanced(seen: GreySurface) -> Iterator[Finding]:
    """Whether the surface is grey once the ratios are set."""
    if seen.clipped > MOST_CLIPPED:
        yield Finding("refused", "clipped", "with the ratios set the surface is saturated: use dimmer light")
    elif seen.off > GOOD_OFF:
        text = (
            f"with the ratios set the colours still differ by {seen.off:.1%}: use light that does not change, and "
            "if grey levels do not follow light, give the response file"
        )
        yield Finding("refused" if seen.off > USABLE_OFF else "warned", "not_balanced", text)


def error_of(first: GreySurface, balanced: GreySurface) -> float:
    """How far the colours may be from grey, as a share: what was left, and how much cells differ."""
    return LEAST_ERROR + balanced.off + 2.0 * max(first.uncertainty, balanced.uncertainty)
