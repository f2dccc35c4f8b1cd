"""Exposures that give an image a mean of one half, as the paper's operator sets them."""

from __future__ import annotations

from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import LIMITS, Radiance, SimulatedCamera, time_first
from imaging.exposure import ExposureSetting

BRIGHTNESS = 0.5
"""The mean that the paper's policies hold, and to which its operator sets the fixed exposure (MH 4.2)."""


def at_half(camera: SimulatedCamera, radiance: Radiance, *, top_only: bool = False) -> ExposureSetting:
    """The setting whose image, or the top half of it, has a mean of one half, as far as the limits allow."""
    low, high = LIMITS.darkest.level, LIMITS.brightest.level
    rows = CAMERA.height // 2 if top_only else CAMERA.height
    for _ in range(12):
        level = (low + high) / 2
        if camera.expose(radiance, time_first(level), 0)[:rows].mean() < BRIGHTNESS * 255:
            low = level
        else:
            high = level
    return time_first((low + high) / 2)
