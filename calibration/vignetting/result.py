"""From looks at a flat field to the simplest vignetting that explains them, and whether to believe it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from calibration.document import Finding, Judged
from calibration.vignetting.field import Array, FieldLook
from imaging.errors import ConfigurationError
from imaging.vignetting import LEAST_LIGHT, Vignetting, hats, middles, radius_squared

Kind = Literal["polynomial", "polynomial about a fitted centre", "grid"]

DEGREE = 4
"""Coefficients of the polynomial: r^2 to r^8. With one less, cos^4 down to 0.3 is missed by 5 % in the corners."""
NODES = 12
"""Nodes of the grid along the longer side."""
BETTER = 0.9
"""A model with more numbers must predict the looks held out with an error this many times as large, or less."""
_ROUNDS = 12
_REACH = 0.5
"""How far a fitted centre may be from the middle, in half diagonals."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A vignetting, and how well it is known; errors are shares of the light."""

    # vignetting, kind: the model that was chosen
    vignetting: Vignetting
    kind: Kind
    # how far each kind, fitted to half of the looks, is from the other half, root mean square
    held_out: dict[Kind, float]
    misfit: float  # how far it is from the mean of all looks, at the worst place
    # how far it may be off because looks differ, at the worst place: half the difference between the two halves
    spread: float


def solve(looks: list[Array], size: tuple[int, int]) -> Solution:
    """The vignetting of frames of a width and height, from at least two looks; ConfigurationError if no lens does that.

    `looks` are the light of cells, each relative to its mean.
    """
    mean = np.mean(looks, axis=0)
    halves = [np.mean(looks[start::2], axis=0) for start in (0, 1)]
    fitted = {kind: [fit(half, size) for half in halves] for kind, fit in _FITS.items()}
    held_out = {
        kind: float(np.mean([off(model, other) for model, other in zip(models, reversed(halves), strict=True)]))
        for kind, models in fitted.items()
    }
    chosen: Kind = "polynomial"
    for kind in _FITS:
        if held_out[kind] < BETTER * held_out[chosen]:
            chosen = kind
    one, other = (_scaled(model, mean.shape) for model in fitted[chosen])
    vignetting = _FITS[chosen](mean, size)
    spread = float(np.abs(one / other - 1.0).max()) / 2.0
    misfit = float(np.abs(residuals(vignetting, mean)).max())
    return Solution(vignetting, chosen, held_out, misfit, spread)


def off(vignetting: Vignetting, light: Array) -> float:
    """How far cells are from a vignetting, as a share of their light, root mean square."""
    return float(np.sqrt(np.mean(residuals(vignetting, light) ** 2)))


def residuals(vignetting: Vignetting, light: Array) -> Array:
    """By how much each cell is brighter than a vignetting says, as a share."""
    return np.asarray(light / light.mean() / _scaled(vignetting, light.shape) - 1.0)


def fit_grid(light: Array, size: tuple[int, int], nodes: int = NODES) -> Vignetting:
    """The grid by least squares, with so many nodes along the longer side."""
    width, height = size
    rows, columns = light.shape
    short = max(min(round(nodes * min(size) / max(size)), min(light.shape) // 2), 2)
    long = max(min(nodes, max(light.shape) // 2), short)
    across, down = (long, short) if width >= height else (short, long)
    of_rows = np.linalg.pinv(hats(middles(rows, height), height, down))
    of_columns = np.linalg.pinv(hats(middles(columns, width), width, across))
    fitted = of_rows @ light @ of_columns.T
    grid = tuple(tuple(round(float(node), 5) for node in row) for row in fitted / fitted.max())
    return Vignetting(width, height, _middle(size), (), grid)


def fit_polynomial(light: Array, size: tuple[int, int], *, about_middle: bool) -> Vignetting:
    """The polynomial by least squares, about the middle of the picture or about the centre that fits best."""
    width, height = size
    x, y = middles(light.shape[1], width), middles(light.shape[0], height)
    centre = np.array(_middle(size))
    weights = 1.0 / np.maximum(light.ravel(), LEAST_LIGHT)  # errors count as shares of the light
    reach_px = _REACH * np.hypot(width, height) / 2.0
    for _ in range(0 if about_middle else _ROUNDS):  # Gauss and Newton, by the slope of the polynomial at its radius
        radius2, powers = _powers(x, y, centre, size)
        fitted = _weighted(powers, light.ravel(), weights)
        slope = np.polynomial.polynomial.polyval(radius2, np.polynomial.polynomial.polyder(fitted))
        scale = -8.0 / (width**2 + height**2)
        shifts = [slope * scale * np.broadcast_to(at, light.shape) for at in (x - centre[0], y[:, None] - centre[1])]
        design = np.column_stack((powers, *(shift.ravel() for shift in shifts)))
        step = _weighted(design, light.ravel() - powers @ fitted, weights)[-2:]
        length_px = float(np.hypot(*step))
        centre += step * min(1.0, 0.1 * reach_px / max(length_px, 1e-9))
        centre = np.clip(centre, np.array(_middle(size)) - reach_px, np.array(_middle(size)) + reach_px)
    _, powers = _powers(x, y, centre, size)
    fitted = _weighted(powers, light.ravel(), weights)
    coefficients = tuple(round(float(value / fitted[0]), 6) for value in fitted[1:])
    return Vignetting(width, height, (round(float(centre[0]), 2), round(float(centre[1]), 2)), coefficients)


def _powers(x: Array, y: Array, centre: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    radius2 = radius_squared(x, y, (float(centre[0]), float(centre[1])), size)
    return radius2, np.vander(radius2.ravel(), DEGREE + 1, increasing=True)


def _weighted(design: Array, values: Array, weights: Array) -> Array:
    return np.asarray(np.linalg.lstsq(design * weights[:, None], values * weights, rcond=1e-9)[0])


def _middle(size: tuple[int, int]) -> tuple[float, float]:
    return (size[0] - 1) / 2.0, (size[1] - 1) / 2.0


def _scaled(vignetting: Vignetting, shape: tuple[int, ...]) -> Array:
    """A vignetting in cells, relative to their mean, as looks are."""
    light = vignetting.relative_light(shape[0], shape[1]).astype(np.float64)
    return np.asarray(light / light.mean())


_FITS: dict[Kind, Callable[[Array, tuple[int, int]], Vignetting]] = {
    "polynomial": partial(fit_polynomial, about_middle=True),
    "polynomial about a fitted centre": partial(fit_polynomial, about_middle=False),
    "grid": fit_grid,
}
"""The simplest first."""


LEAST_LOOKS = 4
MOST_CLIPPED = 1e-3
"""Single pixels may be hot; more of them mean a lamp, or too much light."""
LEAST_GREY = 0.1
MOST_TEXTURE = 0.03
"""Differences within a cell: paper and frosted glass show 1 %, and vignetting across a cell as much."""
MOST_UNEVEN = 0.02
"""Deviations of cells from anything that changes smoothly over the picture."""
GOOD_CHANGE, USABLE_CHANGE = 0.1, 0.3
"""Change of the light from look to look: a surface that is moved may catch more or less of it."""
GOOD_SLOPE, USABLE_SLOPE = 0.03, 0.1
"""By how much light and grey levels may be out of proportion, in stops for each stop."""
GOOD_TILT, USABLE_TILT = 0.05, 0.15
"""Difference between opposite places; a lens that is a twentieth of the picture off centre shows as much."""
GOOD_ERROR, USABLE_ERROR = 0.02, 0.1


def judge_looks(looks: Sequence[FieldLook]) -> Iterator[Finding]:
    """What is wrong with the looks themselves."""
    if len(looks) < LEAST_LOOKS:
        text = f"{len(looks)} pictures: take at least {LEAST_LOOKS}, better 8, from several places of the surface"
        yield Finding("refused", "few_looks", text)
        return
    fields = [look.field for look in looks]
    clipped, grey = max(field.clipped for field in fields), min(field.grey for field in fields)
    if clipped > MOST_CLIPPED:
        text = (
            f"{clipped:.1%} of the picture is saturated: keep lamps and reflections out of it, and take pictures with "
            "a shorter exposure time"
        )
        yield Finding("refused", "saturated", text)
        return
    if grey < LEAST_GREY:
        text = f"the picture is {grey:.0%} of full scale bright: use brighter light, or a longer exposure time"
        yield Finding("refused", "too_dark", text)
        return
    texture = max(field.texture for field in fields)
    if texture > MOST_TEXTURE:
        yield _not_flat(f"neighbouring parts of it differ by {texture:.0%}")
        return
    yield from _judge_light(looks)


def judge_flatness(unevenness: float) -> Iterator[Finding]:
    """Whether looks change smoothly over the picture: `unevenness` is their deviation from anything that does."""
    if unevenness > MOST_UNEVEN:
        yield _not_flat(f"its parts differ by {unevenness:.0%} from anything smooth")


def judge_result(mean: Array, error: float) -> Iterator[Finding]:
    """What is wrong with the mean of the looks, and with what follows from it."""
    tilt = float(np.abs(mean / np.maximum(mean[::-1, ::-1], LEAST_LIGHT) - 1.0).max()) / 2.0
    if tilt > GOOD_TILT:
        text = (
            f"opposite parts of the picture differ by up to {2 * tilt:.0%}: the surface is lit from one side, or the "
            "lens is far off the centre; turn the camera half a turn for half of the looks"
        )
        yield Finding("refused" if tilt > USABLE_TILT else "warned", "uneven_light", text)
    if error > GOOD_ERROR:
        text = (
            f"relative light is known to {error:.1%} only, as the looks differ or no smooth lens explains them: use a "
            "surface that is lit more evenly, and take more looks"
        )
        yield Finding("refused" if error > USABLE_ERROR else "warned", "inconsistent", text)


def _judge_light(looks: Sequence[FieldLook]) -> Iterator[Finding]:
    """Whether the light stayed the same and grey levels follow it, which looks at two exposure times show."""
    slopes = [look.slope for look in looks if look.slope is not None]
    if not slopes:
        return
    levels = np.array([look.field.level for look in looks])
    change = float(levels.max() / levels.min() - 1.0)
    if change > GOOD_CHANGE:
        text = (
            f"the light changed by {change:.0%} from look to look: use light that neither changes nor flickers, and "
            "keep the same part of the surface in view"
        )
        yield Finding("refused" if change > USABLE_CHANGE else "warned", "light_changed", text)
    wrong = abs(float(np.median(slopes)) - 1.0)
    if wrong > GOOD_SLOPE:
        text = (
            f"half the exposure time gives {2.0 ** -float(np.median(slopes)):.3f} of the light, by the response: "
            "grey levels are not in proportion to light; measure the response first (autoexpose calibrate response), "
            "and give its file"
        )
        yield Finding("refused" if wrong > USABLE_SLOPE else "warned", "wrong_response", text)


def _not_flat(seen: str) -> Finding:
    text = f"the surface is not uniform: {seen}: show an evenly lit white wall or paper, or a diffuser, out of focus"
    return Finding("refused", "not_flat", text)


LEAST_ERROR = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class VignettingResult(Judged):
    """Looks at a flat field, what they say, and whether to believe it."""

    name: str  # what was looked at, in a few words
    size: tuple[int, int]  # width and height of the frames
    looks: Sequence[FieldLook]  # what was seen
    findings: tuple[Finding, ...]  # reasons not to believe it
    mean: Array | None = None  # the light of cells, mean of all looks; None if they are refused
    solution: Solution | None = None  # the vignetting; None if the looks give none
    # how far relative light may be from the truth anywhere in the picture, as a share: as far as the looks show
    error: float | None = None

    @property
    def slope(self) -> float | None:
        """Stops of light for a stop of exposure time, according to the response; None: unknown."""
        slopes = [look.slope for look in self.looks if look.slope is not None]
        return float(np.median(slopes)) if slopes else None


def calibrate_vignetting(name: str, size: tuple[int, int], looks: Sequence[FieldLook]) -> VignettingResult:
    """Judge the looks, solve them unless they are refused, and judge the solution."""
    result = VignettingResult(name, size, looks, tuple(judge_looks(looks)))
    if result.verdict == "refused":
        return result
    seen = [look.light for look in looks]
    try:
        unevenness = max(off(fit_grid(light, size), light) for light in seen)
        result = replace(result, mean=np.mean(seen, axis=0), findings=(*result.findings, *judge_flatness(unevenness)))
        if result.verdict == "refused":
            return result
        solution = solve(seen, size)
    except ConfigurationError as error:
        return replace(
            result, findings=(*result.findings, Finding("refused", "no_lens", f"no lens fits these looks: {error}"))
        )
    assert result.mean is not None
    error_share = _error(solution, result.mean.shape, result.slope)
    findings = (*result.findings, *judge_result(result.mean, error_share))
    return replace(result, solution=solution, error=error_share, findings=findings)


def _error(solution: Solution, shape: tuple[int, ...], slope: float | None) -> float:
    """The error that looks, model and response leave open, at the darkest place.

    The picture goes on beyond the middles of the outermost cells, where a misfit doubles. A response that is off by a
    share of each stop is off by the same share of what the lens takes away.
    """
    depth = -math.log2(float(solution.vignetting.relative_light(shape[0], shape[1]).min()))
    by_response = 0.0 if slope is None else 2.0 ** (depth * abs(slope - 1.0)) - 1.0
    return LEAST_ERROR + solution.spread + 2.0 * solution.misfit + by_response
