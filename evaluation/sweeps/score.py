"""What a calibration states about its error, against the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from calibration.response.file import SIGMAS, Origin, ResponseSolution
from calibration.result import Verdict, calibrate
from evaluation.sweeps.simulated import SimulatedSweep
from imaging.response import ResponseFunction


@dataclass(frozen=True, slots=True)
class Stated:
    """One sweep: the verdict, and the error stated and true."""

    # seed, kind, processing, curve, scene, repeated, good: of the sweep, see `SimulatedSweep`.
    seed: int
    kind: str
    processing: str
    curve: str
    scene: str
    repeated: bool
    good: bool
    # verdict, reasons: of the calibration.
    verdict: Verdict
    reasons: tuple[str, ...]
    # stated_stops, true_stops: see `errors_stops`; None where the sweep was refused, which states nothing.
    stated_stops: float | None
    true_stops: float | None
    seconds: float  # processor time of the calibration

    @property
    def covered(self) -> bool:
        """Whether the stated error is at least the true one, or nothing is stated."""
        return self.stated_stops is None or self.true_stops is None or self.true_stops <= self.stated_stops


def scored(seed: int, case: SimulatedSweep) -> Stated:
    """Calibrate with a sweep and compare."""
    start_s = time.process_time()
    result = calibrate("simulated", Origin(), case.sweep, brighter=lambda: case.brighter)
    seconds = time.process_time() - start_s
    kept = None if result.file is None else result.solution
    stated, true = (None, None) if kept is None else errors_stops(kept, case.true)
    reasons = tuple(finding.reason for finding in result.findings)
    return Stated(
        seed,
        case.kind,
        case.processing,
        case.curve,
        case.scene,
        case.repeated,
        case.good,
        result.verdict,
        reasons,
        stated,
        true,
        seconds,
    )


def errors_stops(solution: ResponseSolution, true: ResponseFunction) -> tuple[float, float]:
    """The error as the report states it, and the true one (stops), both the largest over the accurate grey levels."""
    assert solution.accurate is not None
    low, high = solution.accurate
    accurate = np.arange(low, high + 1)
    difference = solution.response.log2_exposure - true.log2_exposure
    true_stops = float(np.abs(difference[accurate] - difference[(low + high) // 2]).max())
    return SIGMAS * float(solution.uncertainty_stops[accurate].max()), true_stops
