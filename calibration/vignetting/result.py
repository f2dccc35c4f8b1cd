"""From looks at a flat field to a judged vignetting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.findings import Finding
from calibration.result import Verdict, verdict
from calibration.vignetting.field import Array
from calibration.vignetting.judge import judge_flatness, judge_looks, judge_result
from calibration.vignetting.look import Look
from calibration.vignetting.solve import Solution, fit_grid, off, solve
from imaging.errors import ConfigurationError

LEAST_ERROR = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class VignettingResult:
    """Looks at a flat field, what they say, and whether to believe it.

    Attributes
    ----------
    name
        What was looked at, in a few words.
    size
        Width and height of the frames.
    looks
        What was seen.
    findings
        Reasons not to believe it.
    mean
        The light of cells, mean of all looks; None if they are refused.
    solution
        The vignetting; None if the looks give none.
    error
        How far relative light may be from the truth anywhere in the picture, as a share: as far as the looks show.
    """

    name: str
    size: tuple[int, int]
    looks: Sequence[Look]
    findings: tuple[Finding, ...]
    mean: Array | None = None
    solution: Solution | None = None
    error: float | None = None

    @property
    def verdict(self) -> Verdict:
        """Whether to believe it."""
        return verdict(self.findings)

    @property
    def slope(self) -> float | None:
        """Stops of light for a stop of exposure time, according to the response; None: unknown."""
        slopes = [look.slope for look in self.looks if look.slope is not None]
        return float(np.median(slopes)) if slopes else None


def calibrate_vignetting(name: str, size: tuple[int, int], looks: Sequence[Look]) -> VignettingResult:
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
