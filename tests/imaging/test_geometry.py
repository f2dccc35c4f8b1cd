"""Where the right camera of a pair stands, by the files of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration.geometry.file import load_geometry
from imaging.geometry import pose_in
from tests.calibration.geometry.written import kalibr, made_rig


def turned(rotation_xyzw: tuple[float, float, float, float]) -> np.ndarray:
    x, y, z, w = rotation_xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.parametrize(
    "turn", [(0.0, 0.0, 0.0), (0.01, -0.02, 0.005), (0.3, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 0.2)]
)
def test_it_is_where_the_calibration_saw_it(turn: tuple[float, float, float], tmp_path: Path) -> None:
    rig = made_rig(turn)
    file = kalibr(rig, tmp_path)
    pose = pose_in("left", load_geometry(file, "left"), load_geometry(file, "right"))
    assert pose.of == "left"
    assert pose.translation_m == pytest.approx(tuple(-rig.rotation.T @ rig.translation_m), abs=1e-6)
    assert turned(pose.rotation_xyzw) == pytest.approx(rig.rotation.T, abs=1e-6)
    assert pose.rotation_xyzw[3] >= 0
