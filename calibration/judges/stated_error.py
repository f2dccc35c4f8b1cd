"""What a sweep cannot show, as part of the error that is stated for its response."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.findings import Finding
from calibration.judges.noise_witness import NoiseWitness
from calibration.response import ResponseFunction
from calibration.response.solution import ResponseSolution
from calibration.solver.tones import Curve, Tones

UNIFORM_STOPS = 1.0
"""Parts of the scene that differ by less see the same light at no two exposures, and so do not link them."""

HIDDEN_STOPS = 0.1
"""Grey levels of a uniform scene whose light may be off by more, through an offset of the exposure times that only
noise could show, do not count as covered."""


def is_uniform(tones: Tones, response: ResponseFunction) -> bool:
    """Whether a scene has one brightness only: then grey levels cannot tell a curve from wrong exposure times."""
    greys = tones.greys - tones.middle
    inside = (greys > response.black_level + 1) & (greys < response.saturation - 1)
    row = int(np.argmax(inside.sum(axis=1)))
    light = response.inverse_between(greys[row][inside[row]])
    return bool(inside[row].mean() > 0.5 and np.ptp(np.percentile(light, [2, 98])) < UNIFORM_STOPS)


def with_doubts(solution: ResponseSolution, tones: Tones, witness: NoiseWitness | None) -> ResponseSolution:
    """The solution, its errors widened by what neither grey levels nor noise rule out, and its dark end not covered."""
    stops = solution.response.log2_exposure
    uniform = is_uniform(tones, solution.response)
    bounds = []
    if witness is not None and witness.doubted:
        bounds.append((witness.power - 1.0) * stops)
    covered = solution.covered
    if witness is not None and uniform:
        hidden = np.log2(1.0 + witness.dark_light / np.exp2(stops))
        bounds.append(hidden)
        low = next((grey for grey in range(covered[0], covered[1]) if hidden[grey] < HIDDEN_STOPS), covered[1] - 1)
        covered = (low, covered[1])
    if witness is None and uniform:
        # As far as grey levels go, the sensor may be linear, and the exposure times wrong.
        bounds.append(stops - ResponseFunction.linear(solution.response.black_level).log2_exposure)
    # A bound counts as two standard errors.
    parts = [solution.uncertainty_stops, *(_from_the_middle(bound, covered) / 2.0 for bound in bounds)]
    return replace(solution, covered=covered, uncertainty_stops=np.sqrt(np.sum(np.square(parts), axis=0)))


def uniform_scene(solution: ResponseSolution, tones: Tones, witness: NoiseWitness | None) -> Finding | None:
    """A scene that cannot show wrong exposure times, and noise that cannot either."""
    if witness is not None or not is_uniform(tones, solution.response):
        return None
    text = (
        "the scene has one brightness only, which cannot tell a curve from wrong exposure times, and the images have "
        "too little noise to ask: show bright and dark parts, and take more exposures"
    )
    return Finding("warned", "uniform_scene", text)


def _from_the_middle(bound: Curve, covered: tuple[int, int]) -> Curve:
    """Its amount counted from the middle of the covered grey levels, where the stated error is 0."""
    return np.asarray(np.abs(bound - bound[(covered[0] + covered[1]) // 2]))
