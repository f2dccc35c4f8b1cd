"""The error of an estimated trajectory: relative pose errors, by evo."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SUB_TRAJECTORY_M = 0.02
"""Path length over which errors accumulate (Begin & Hunter 2022, section 3.1)."""

TOLERANCE = 0.1
"""By which share a sub-trajectory's length may be off."""


def relative_errors_mm(
    truth: Sequence[NDArray[np.float64]],
    estimate: Sequence[NDArray[np.float64]],
    length_m: float = SUB_TRAJECTORY_M,
    tolerance: float = TOLERANCE,
) -> list[float]:
    """Translation RPE (mm) over each sub-trajectory of a length, one beginning at every pose.

    Lengths are measured along the true path: the estimated one is longer because of its noise.

    Parameters
    ----------
    truth, estimate
        Poses (4, 4) in metres at the same instants, each in its own frame of reference.
    length_m, tolerance
        Of a sub-trajectory, and by which share it may be off.
    """
    from evo.core.metrics import RPE, PoseRelation, Unit  # noqa: PLC0415  takes half a second to load
    from evo.core.trajectory import PosePath3D  # noqa: PLC0415

    errors = RPE(
        PoseRelation.translation_part,
        length_m,
        Unit.meters,
        rel_delta_tol=tolerance,
        all_pairs=True,
        pairs_from_reference=True,
    )
    errors.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate))))
    return [1e3 * float(error) for error in errors.error]
