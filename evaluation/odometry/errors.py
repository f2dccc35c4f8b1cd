"""How far an estimated trajectory is off: relative pose errors, by evo."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SUB_TRAJECTORY_M = 0.02
"""Length of the way over which errors add up (Begin & Hunter 2022, section 3.1)."""

TOLERANCE = 0.1
"""How far a sub-trajectory's length may be off, as a share."""


def relative_errors_mm(truth: Sequence[NDArray[np.float64]], estimate: Sequence[NDArray[np.float64]]) -> list[float]:
    """Translation RPE (mm) over each sub-trajectory of 20 mm, beginning at every pose.

    Lengths are those of the true way: the estimated one is longer by its own noise.

    Parameters
    ----------
    truth, estimate
        Poses (4, 4) in metres at the same instants; each in a frame of its own.
    """
    from evo.core.metrics import RPE, PoseRelation, Unit  # noqa: PLC0415  it takes half a second to load
    from evo.core.trajectory import PosePath3D  # noqa: PLC0415

    errors = RPE(
        PoseRelation.translation_part,
        SUB_TRAJECTORY_M,
        Unit.meters,
        rel_delta_tol=TOLERANCE,
        all_pairs=True,
        pairs_from_reference=True,
    )
    errors.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate))))
    return [1e3 * float(error) for error in errors.error]
