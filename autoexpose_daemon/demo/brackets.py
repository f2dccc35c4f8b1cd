"""What the simulated rig is calibrated with when the demo records brackets: `rejudge` follows it by odometry."""

from __future__ import annotations

from pathlib import Path

from calibration.geometry.formats.ros import ros_yaml
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry

SENSOR = {"full_well_e": 22_000.0, "read_noise_e": 3.0}
"""As `autoexpose calibrate noise` finds them."""

_FOCAL_WIDTHS = 860 / 720
_BASELINE_M = 0.08


def geometry_files(width_height: tuple[int, int], folder: Path) -> dict[Side, dict[str, str]]:
    """Write the geometry of both cameras; returns the keys for the configuration."""
    return {side: _written(side, width_height, folder) for side in SIDES}


def _written(side: Side, width_height: tuple[int, int], folder: Path) -> dict[str, str]:
    width, height = width_height
    focal_px, x, y = _FOCAL_WIDTHS * width, (width - 1) / 2, (height - 1) / 2
    shift = -focal_px * _BASELINE_M if side == "right" else 0.0
    k = (focal_px, 0.0, x, 0.0, focal_px, y, 0.0, 0.0, 1.0)
    p = (focal_px, 0.0, x, shift, 0.0, focal_px, y, 0.0, 0.0, 0.0, 1.0, 0.0)
    unturned = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    geometry = CameraGeometry(width, height, "plumb_bob", (0.0,) * 5, k, unturned, p)
    file = folder / f"{side}.yaml"
    file.write_text(ros_yaml(geometry, side), encoding="ascii")
    return {"calibration": str(file)}
