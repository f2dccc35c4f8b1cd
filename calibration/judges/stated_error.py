"""What a sweep cannot show, as part of the error that is stated for its response, and where that error is small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.findings import Finding
from calibration.judges.noise_witness import NoiseWitness
from calibration.response.facts import SIGMAS
from calibration.response.solution import ResponseSolution
from calibration.solver.tones import Curve
from imaging.response import ResponseFunction

ACCURACIES_STOPS = (0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
ACCURATE_SHARE = 0.75
"""Accurate are the grey levels that are known to the best of these errors to which so many of those seen are known."""

MIXED_GREY = 16
"""Grey levels from black and saturation within which the responses of simulated cameras that denoise were off most."""

ROUNDS = 3
"""Errors count from the middle of the accurate grey levels, and decide which those are."""


def with_doubts(
    solution: ResponseSolution, witness: NoiseWitness | None, *, one_brightness: bool = False
) -> ResponseSolution:
    """The solution, its errors widened by what neither grey levels nor noise rule out, and where they are small.

    The witness is None where noise says nothing. `one_brightness`: the scene had only one, whatever the gains.
    """
    stops = solution.response.log2_exposure
    own, bounds = solution.uncertainty_stops, []
    if witness is None:
        # Compression and denoising move medians of alike pixels alike: their errors do not average out.
        own = np.hypot(own, solution.residual_grey * np.gradient(stops))
        solution = replace(solution, covered=_clear_of_ends(solution))
    elif witness.doubted:
        bounds.append((witness.power - 1.0) * stops)
    if solution.uniform:
        hidden = min(solution.hidden_light, witness.dark_light) if witness else solution.hidden_light
        bounds.append(np.log2(1.0 + hidden / np.exp2(stops)))
    if witness is None and (solution.uniform or one_brightness):
        # As far as grey levels go, the sensor may be linear, and the exposure times wrong.
        bounds.append(stops - ResponseFunction.linear(solution.response.black_level).log2_exposure)

    def uncertainty(middle: int) -> Curve:
        parts = [own, np.full(len(own), own[middle]), *((bound - bound[middle]) / SIGMAS for bound in bounds)]
        return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))

    accurate = solution.covered
    for _ in range(ROUNDS):
        middle = sum(accurate) // 2
        accurate = _accurate(solution.covered, middle, uncertainty(middle))
    return replace(solution, accurate=accurate, uncertainty_stops=uncertainty(sum(accurate) // 2))


def _clear_of_ends(solution: ResponseSolution) -> tuple[int, int]:
    """What is covered where pixels may be mixed with clipped neighbours, which have no brightness of their own."""
    low, high = solution.covered
    response = solution.response
    low, high = max(low, response.black_level + MIXED_GREY), min(high, response.saturation - MIXED_GREY)
    return (low, high) if low < high else solution.covered


def _accurate(seen: tuple[int, int], middle: int, uncertainty: Curve) -> tuple[int, int]:
    """The grey levels around one that are known to the best of `ACCURACIES_STOPS` to which enough are known."""
    for accuracy in ACCURACIES_STOPS:
        beyond = np.flatnonzero(SIGMAS * uncertainty > accuracy)
        low = max(seen[0], int(beyond[beyond < middle].max(initial=-1)) + 1)
        high = min(seen[1], int(beyond[beyond > middle].min(initial=len(uncertainty))) - 1)
        if high - low >= ACCURATE_SHARE * (seen[1] - seen[0]):
            return low, high
    return seen


def uniform_scene(one_brightness: bool, witness: NoiseWitness | None) -> Finding | None:
    """A scene that cannot show wrong exposure times, and noise that cannot either."""
    if witness is not None or not one_brightness:
        return None
    text = (
        "the scene has one brightness only, which cannot tell a curve from wrong exposure times, and neither can the "
        "noise of these images: show bright and dark parts, and take more exposures"
    )
    return Finding("warned", "uniform_scene", text)


def gains_disagree(gain_db: float) -> Finding:
    """A second sweep at a higher gain (dB) that makes no sense together with the first, which does on its own."""
    text = (
        f"the sweep at {gain_db:.1f} dB contradicts the one at the lower gain: exposure times are off, the black level "
        "rises with the gain, or the light changed: show bright and dark parts"
    )
    return Finding("warned", "gains_disagree", text)
