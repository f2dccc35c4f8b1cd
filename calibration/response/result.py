"""From a sweep to a judged response function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from calibration.document import Finding, Judged
from calibration.response.curves import covered_greys
from calibration.response.file import Origin, ResponseFile, ResponseSolution
from calibration.response.judgement import gains_disagree, judge_solution, judge_sweep, uniform_scene, widen_errors
from calibration.response.noise_witness import NoiseWitness, hear_noise
from calibration.response.solve import solve_tones
from calibration.response.tones import (
    Agreement,
    Tones,
    agreement,
    exposure_index,
    of_exposures,
    tones_by_shot,
    with_brighter,
)
from calibration.sweep import Shot, Sweep


@dataclass(frozen=True, slots=True, eq=False)
class Result(Judged):
    """A sweep, what it says, and whether to believe it."""

    name: str  # what was swept, in a few words
    origin: Origin  # camera and mode
    sweep: Sweep  # the images
    # by_shot, by_exposure: grey levels of parts of the scene in them
    by_shot: Tones
    by_exposure: Tones
    findings: tuple[Finding, ...]  # reasons not to believe it
    notes: tuple[str, ...] = ()  # the camera's limitations, in words
    # solution, agreement: the response, and how well it predicts the sweep's own images from each other; None when the
    # sweep gives none
    solution: ResponseSolution | None = None
    agreement: Agreement | None = None
    # what the noise of the images says about the response, if it is that of photons; None: there is too little
    witness: NoiseWitness | None = None
    # noise, latency: what was measured of this camera earlier, as its response file has it
    noise: Mapping[str, Any] = field(default_factory=dict)
    latency: Mapping[str, Any] = field(default_factory=dict)

    @property
    def file(self) -> ResponseFile | None:
        """What to save of it: nothing if it is refused."""
        if self.solution is None or self.verdict == "refused":
            return None
        file = ResponseFile.of_solution(self.solution, self.origin, self.findings)
        times_checked = self.witness is not None and self.witness.photons
        return replace(file, noise=self.noise, latency=self.latency, times_checked=times_checked)

    def keeping(self, previous: ResponseFile | None) -> Result:
        """This result with the noise and latency that were measured of the same camera before."""
        if previous is None or self.origin.camera is None or previous.origin.camera != self.origin.camera:
            return self
        return replace(self, noise=previous.noise, latency=previous.latency)


def calibrate(
    name: str,
    origin: Origin,
    sweep: Sweep,
    notes: tuple[str, ...] = (),
    brighter: Callable[[], tuple[Shot, ...]] = tuple,
) -> Result:
    """Judge a sweep, solve it unless it is refused, and judge the solution.

    If the scene turns out to have one brightness only, `brighter` is asked for the sweep at a higher gain (see
    `Sweep.brighter`), and both are solved together. It may return nothing. Chance may have refused the first by itself,
    which is forgotten if both together give no reason to doubt the same.
    """
    alone = _calibrate(name, origin, sweep, notes)
    shots = brighter() if alone.solution is not None and alone.solution.uniform else ()
    if not shots:
        return alone
    if len(exposure_index(sweep)[0]) == len(exposure_index(Sweep(shots))[0]):
        both = _calibrate(name, origin, replace(sweep, brighter=shots), notes)
        refusals = {finding.reason for finding in alone.findings if finding.severity == "refused"}
        if both.verdict != "refused" and refusals.isdisjoint(finding.reason for finding in both.findings):
            return both
    return replace(alone, findings=(*alone.findings, gains_disagree(shots[0].setting.gain_db)))


def _calibrate(name: str, origin: Origin, sweep: Sweep, notes: tuple[str, ...]) -> Result:
    by_shot = tones_by_shot(sweep)
    at_first_gain = of_exposures(by_shot, *exposure_index(sweep))
    by_exposure = with_brighter(at_first_gain, sweep)
    result = Result(name, origin, sweep, by_shot, by_exposure, tuple(judge_sweep(sweep)), notes)
    if result.verdict == "refused":
        return result
    solved = replace(solve_tones(by_exposure, two_gains=bool(sweep.brighter)), covered=covered_greys(at_first_gain))
    witness = hear_noise(sweep, solved.response)
    heard = witness if witness is not None and witness.photons else None
    one_brightness = solved.uniform or bool(sweep.brighter)
    solution = widen_errors(solved, heard, one_brightness=one_brightness)
    doubts = [None if heard is None else heard.finding, uniform_scene(one_brightness, heard)]
    return replace(
        result,
        solution=solution,
        witness=witness,
        agreement=agreement(solution.response, by_exposure),
        findings=(*result.findings, *judge_solution(sweep, solution), *(doubt for doubt in doubts if doubt)),
    )
