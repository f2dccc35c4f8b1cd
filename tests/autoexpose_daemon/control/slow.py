"""Images for tests of metrics, and the parts of slow reference metrics: loops over pixels, straight from the
equations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def random_image(seed: int, height: int = 13, width: int = 17) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    contrast = rng.choice([10, 60, 256])
    low = rng.integers(0, 257 - contrast)
    return rng.integers(low, low + contrast, (height, width)).astype(np.uint8)


def random_weights(seed: int, height: int = 13, width: int = 17) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    return (rng.integers(1, 256, (height, width)) * (rng.random((height, width)) > 0.3)).astype(np.uint8)


def pixels(image: NDArray[np.uint8]) -> list[tuple[int, int]]:
    return [(y, x) for y in range(image.shape[0]) for x in range(image.shape[1])]


def mirrored(image: NDArray[np.uint8] | NDArray[np.float64], y: int, x: int) -> float:
    height, width = image.shape
    y = -y if y < 0 else 2 * (height - 1) - y if y >= height else y
    x = -x if x < 0 else 2 * (width - 1) - x if x >= width else x
    return float(image[y, x])


def filtered(
    image: NDArray[np.uint8] | NDArray[np.float64], y: int, x: int, kernel: tuple[tuple[float, ...], ...]
) -> float:
    return sum(kernel[j + 1][i + 1] * mirrored(image, y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1))


def magnitude(image: NDArray[np.uint8], y: int, x: int) -> int:
    dx = filtered(image, y, x, ((-1, 0, 1), (-2, 0, 2), (-1, 0, 1)))
    dy = filtered(image, y, x, ((-1, -2, -1), (0, 0, 0), (1, 2, 1)))
    return min(255, round(math.hypot(dx, dy)))


def weight_of(weights: NDArray[np.uint8] | None, y: int, x: int) -> float:
    return 1.0 if weights is None else float(weights[y, x])
