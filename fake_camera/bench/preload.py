"""Imported in the process that fake cameras are forked from: what each of them would do at its start."""

from __future__ import annotations

import cv2

from fake_camera.__main__ import main
from fake_camera.world.lighting import LightScript
from fake_camera.world.simulation import build_image_source

__all__ = ["main"]

cv2.setNumThreads(1)  # a fork has no threads but its own
build_image_source("room", "left", LightScript.default(), seed=0)
