"""Pictures with corners and blobs of several sizes, as trees have."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from navigation.views.features import AdaptiveFinder, FastOrb, OrbPyramid, UprightSift

HEIGHT, WIDTH = 540, 720

Finder = AdaptiveFinder | OrbPyramid

FINDERS = {
    "fast-orb": lambda: AdaptiveFinder(FastOrb()),
    "sift": lambda: AdaptiveFinder(UprightSift()),
    "orb-pyramid": OrbPyramid,
}
"""What makes a new one of each kind."""


def texture(seed: int, width: int = WIDTH) -> NDArray[np.float64]:
    """Mean 0, standard deviation 1, shape (540, width)."""
    rng = np.random.default_rng(seed)
    blots = [cv2.GaussianBlur(rng.normal(size=(HEIGHT, width)), (0, 0), sigma) for sigma in (1.0, 2.0, 5.0)]
    mixed = np.sum([blot / blot.std() for blot in blots], axis=0)
    return np.asarray((mixed - mixed.mean()) / mixed.std())


def picture(grey: NDArray[np.float64], rng: np.random.Generator, noise: float = 1.0) -> NDArray[np.uint8]:
    """Grey levels with noise of so many (standard deviation), clipped as a camera does."""
    return np.clip(np.round(grey + rng.normal(0.0, noise, grey.shape)), 0, 255).astype(np.uint8)
