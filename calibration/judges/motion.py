"""Whether anything moved, from shots of one exposure taken at different times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.solver.tones import exposure_index, grey8
from calibration.sources.sweep import Sweep
from imaging.response import GREY_LEVELS, ResponseFunction, prediction_table

BLOCK_PX = 16

MOVED_CORRELATION = 0.35
"""Correlation between neighbouring pixels of a block's change: 0 for noise, above a half for edges that moved."""

MOVED_GREY = 1.0
"""Root of the covariance between neighbouring pixels: less does not show in medians."""

TEXTURED_GREY = 2.0
"""Standard deviation within a block: with less, nothing shows that it moved."""

SEEN_AGAIN = 0.9
"""Correlation of a block with the same one in the next shot: with less, it is noise as much as texture."""

SHIFTED = 0.3
"""Share of a change that a shift explains, which compression and denoising do not make."""

REPLACED = 0.5
"""Share of the texture that changed, from which no shift is asked for: noise in what is seen again is less."""

Blocks = NDArray[np.float32]

EXPOSURES = 4
"""Blocks examined, those with the most contrast: motion shows in each of them."""


def moved_share(sweep: Sweep) -> float:
    """Share of textured blocks of the image in which something moved; 0 when no exposure was taken twice."""
    _, index = exposure_index(sweep)
    shares = [0.0]
    for first, last in _pairs(sweep, index):
        one, other, after = (
            _blocks(grey8(sweep.shots[k]).astype(np.float32)) for k in (first, last, min(first + 1, last))
        )
        shares.append(_moved(one, other, _correlation(one, after) > SEEN_AGAIN))
    return max(shares)


def moved_share_between_exposures(sweep: Sweep, response: ResponseFunction) -> float:
    """The same for sweeps that took each exposure once: neighbouring exposures, the brighter one predicted darker."""
    levels, index = exposure_index(sweep)
    shares = [0.0]
    for darker in range(len(levels) - 1):
        dark, bright = (sweep.shots[int(np.flatnonzero(index == i)[0])] for i in (darker, darker + 1))
        table = prediction_table(response, float(levels[darker] - levels[darker + 1])).astype(np.float32)
        table[response.saturation - 1 :] = GREY_LEVELS - 1  # clipped, and left out as such
        one, other = _blocks(table[grey8(bright)]), _blocks(grey8(dark).astype(np.float32))
        shares.append(_moved(one, other, np.ones(len(one), bool)))
    return max(shares)


def _pairs(sweep: Sweep, index: NDArray[np.intp]) -> list[tuple[int, int]]:
    """The first and last shots of the exposures whose images show most contrast."""
    pairs = []
    for exposure in range(index.max() + 1):
        shots = np.flatnonzero(index == exposure)
        if len(shots) > 1:
            pairs.append((float(np.std(grey8(sweep.shots[shots[0]])[::4, ::4])), int(shots[0]), int(shots[-1])))
    return [(first, last) for _, first, last in sorted(pairs, reverse=True)[:EXPOSURES]]


def _blocks(image: NDArray[np.float32]) -> Blocks:
    """The image cut into square blocks, shape (blocks, BLOCK_PX, BLOCK_PX)."""
    rows, columns = (size // BLOCK_PX for size in image.shape)
    cut = image[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
    return cut.swapaxes(1, 2).reshape(-1, BLOCK_PX, BLOCK_PX)


def _moved(one: Blocks, other: Blocks, textured: NDArray[np.bool_]) -> float:
    """Share of the textured, unclipped blocks whose change, apart from their light, is more than noise."""
    if not one.size:  # images smaller than a block
        return 0.0
    low, high = min(one.min(), other.min()), max(one.max(), other.max())
    inside = textured.copy()
    for blocks in (one, other):
        inside &= (blocks.min(axis=(1, 2)) > low + 2) & (blocks.max(axis=(1, 2)) < high - 2)
    inside &= (one.std(axis=(1, 2)) > TEXTURED_GREY) | (other.std(axis=(1, 2)) > TEXTURED_GREY)
    if inside.sum() < 4:
        return 0.0
    one, other = (_centred(blocks[inside]) for blocks in (one, other))
    gain = (one * other).sum(axis=(1, 2), keepdims=True) / np.maximum((one**2).sum(axis=(1, 2), keepdims=True), 1e-3)
    changed = other - gain * one
    variance = np.mean(changed**2, axis=(1, 2))
    across = np.mean(changed[:, :, 1:] * changed[:, :, :-1], axis=(1, 2))
    down = np.mean(changed[:, 1:] * changed[:, :-1], axis=(1, 2))
    covariance = (across + down) / 2
    spread = (covariance > MOVED_CORRELATION * variance) & (covariance > MOVED_GREY**2)
    replaced = variance > REPLACED * other.var(axis=(1, 2))
    return float((spread & (replaced | (_shifted_share(changed, one + other) > SHIFTED))).mean())


def _shifted_share(changed: Blocks, texture: Blocks) -> NDArray[np.float32]:
    """Share of the change in each block that a small shift of its texture explains: a sum of its two gradients."""
    down, across = (gradient.reshape(len(texture), -1) for gradient in np.gradient(texture, axis=(1, 2)))
    flat = changed.reshape(len(changed), -1)
    gradients = np.stack([down, across], axis=1)
    normal = gradients @ gradients.swapaxes(1, 2) + 1e-3 * np.eye(2, dtype=np.float32)
    right = gradients @ flat[:, :, None]
    explained = (right * np.linalg.solve(normal, right)).sum(axis=(1, 2))
    return np.asarray(explained / np.maximum((flat**2).sum(axis=1), 1e-3))


def _correlation(one: Blocks, other: Blocks) -> NDArray[np.float32]:
    one, other = _centred(one), _centred(other)
    product = (one**2).sum(axis=(1, 2)) * (other**2).sum(axis=(1, 2))
    return np.asarray((one * other).sum(axis=(1, 2)) / np.sqrt(np.maximum(product, 1e-3)))


def _centred(blocks: Blocks) -> Blocks:
    return np.asarray(blocks - blocks.mean(axis=(1, 2), keepdims=True))
