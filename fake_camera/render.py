"""Renders textured rectangles fast enough for a live camera: plain loops over tiles, compiled by numba.

A rectangle seen by a pinhole camera is one 3x3 matrix: with corner O and edges U, V in camera coordinates, pixel p lies
at (a, b) of the rectangle and at depth z where (a, b, 1) / z = [U V O]^-1 K^-1 p. All three are linear in the pixel, so
a test at the four corners of a tile holds for the whole tile, and most tiles see a single rectangle.
"""

# Compiled kernels take plain arrays and numbers, by position:
# ruff: noqa: PLR0917

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

TILE_WIDTH, TILE_HEIGHT = 24, 18


@dataclass(frozen=True, slots=True)
class Pinhole:
    """An ideal camera: size in pixels and focal length in pixels, the optical axis through the middle."""

    width: int = 720
    height: int = 540
    focal_px: float = 860.0


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A rectangle that sends light; it is seen only from the side where `edge_u` goes right and `edge_v` goes down.

    Attributes
    ----------
    corner, edge_u, edge_v
        Upper left corner and the two edges in world metres, shape (3,).
    pattern
        What it sends, in lux times reflectance, shape (rows, columns), float32: radiance per lux of the room's light
        for `follows_light`, else absolute radiance.
    follows_light
        Whether its radiance is in proportion to the room's light.
    """

    corner: NDArray[np.float64]
    edge_u: NDArray[np.float64]
    edge_v: NDArray[np.float64]
    pattern: NDArray[np.float32]
    follows_light: bool = True


class Renderer:
    """Renders surfaces as seen by one camera; what `render` returns is overwritten by the next call."""

    def __init__(self, surfaces: Sequence[Surface], camera: Pinhole) -> None:
        self.camera = camera
        self._corners = np.array([[s.corner, s.edge_u, s.edge_v] for s in surfaces])
        self._follows_light = np.array([s.follows_light for s in surfaces])
        self._texels, self._levels, self._counts, self._scales = _pack([s.pattern for s in surfaces])
        self._radiance = np.empty((camera.height, camera.width), np.float32)

    def render(self, poses: NDArray[np.float64], lux: float) -> NDArray[np.float32]:
        """Mean radiance over the poses, in lux times reflectance; it is affine in `lux`.

        Parameters
        ----------
        poses
            Camera poses during the exposure, camera to world, shape (poses, 4, 4).
        lux
            Mean illumination by the room's light during the exposure.

        Returns
        -------
        Shape (height, width), float32.
        """
        camera = self.camera
        matrices = _matrices(self._corners, poses, camera.focal_px, (camera.width - 1) / 2, (camera.height - 1) / 2)
        scales = self._scales * np.where(self._follows_light, lux, 1.0) / len(poses)
        _render(matrices, scales.astype(np.float32), self._texels, self._levels, self._counts, self._radiance)
        return self._radiance


def _pack(
    patterns: Sequence[NDArray[np.float32]],
) -> tuple[NDArray[np.uint16], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """All patterns with their mip levels in one array of 16-bit texels, each padded at its right and lower edge.

    Returns texels; (offset, rows, columns) by surface and level, shape (surfaces, 12, 3); levels by surface; and the
    radiance of one texel step by surface.
    """
    texels: list[NDArray[np.uint16]] = []
    levels = np.zeros((len(patterns), 12, 3), np.int64)
    counts = np.zeros(len(patterns), np.int64)
    scales = np.array([max(float(pattern.max()), 1e-9) / 65535.0 for pattern in patterns])
    offset = 0
    for index, full in enumerate(patterns):
        pattern = full
        while counts[index] < levels.shape[1]:
            rows, columns = pattern.shape
            levels[index, counts[index]] = offset, rows, columns
            counts[index] += 1
            steps = np.rint(pattern / scales[index]).astype(np.uint16)
            texels.append(np.pad(steps, ((0, 1), (0, 1)), mode="edge").ravel())
            offset += texels[-1].size
            if min(rows, columns) < 4:
                break
            half = cv2.resize(pattern, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
            pattern = np.asarray(half, np.float32)
    return np.concatenate(texels), levels, counts, scales


@njit(cache=True, nogil=True)
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True)
def _matrices(corners, poses, focal, centre_x, centre_y):  # type: ignore[no-untyped-def]
    """Pixel to (a, b, 1) / z by pose and surface, shape (poses, surfaces, 3, 3); 0 for surfaces seen from behind."""
    matrices = np.zeros((len(poses), len(corners), 3, 3))
    seen = np.empty((3, 3))
    rows = np.empty((3, 3))
    for p in range(len(poses)):
        rotation = poses[p, :3, :3]
        for s in range(len(corners)):
            for i in range(3):
                for axis in range(3):
                    total = 0.0
                    for j in range(3):
                        moved = corners[s, i, j] - (poses[p, j, 3] if i == 0 else 0.0)
                        total += rotation[j, axis] * moved
                    seen[i, axis] = total
            _cross(seen[2], seen[0], rows[0])
            _cross(seen[0], seen[1], rows[1])
            _cross(seen[1], seen[2], rows[2])
            determinant = 0.0
            for axis in range(3):
                determinant += seen[0, axis] * rows[2, axis]
            if determinant <= 1e-9:
                continue
            for i in range(3):
                a, b = rows[i, 0] / (determinant * focal), rows[i, 1] / (determinant * focal)
                matrices[p, s, i, 0] = a
                matrices[p, s, i, 1] = b
                matrices[p, s, i, 2] = rows[i, 2] / determinant - a * centre_x - b * centre_y
    return matrices


@njit(cache=True, nogil=True)
def _cover(matrix, left, top, right, bottom):  # type: ignore[no-untyped-def]
    """How a surface covers a tile: 0 not, 1 perhaps partly, 2 wholly; and its least and greatest 1 / z there."""
    before, right_of, left_of, below, above = 0, 0, 0, 0, 0
    least, greatest = np.inf, -np.inf
    for corner in range(4):
        x, y = (left if corner & 1 else right), (top if corner & 2 else bottom)
        a = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
        b = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
        w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
        before += w > 0
        right_of += a >= 0
        left_of += a <= w
        below += b >= 0
        above += b <= w
        least, greatest = min(least, w), max(greatest, w)
    if before == 0 or right_of == 0 or left_of == 0 or below == 0 or above == 0:
        return 0, least, greatest
    return (2 if before + right_of + left_of + below + above == 20 else 1), least, greatest


@njit(cache=True, nogil=True)
def _level(matrix, x, y, shapes, count):  # type: ignore[no-untyped-def]
    """The mip level whose texels are about one pixel wide at (x, y)."""
    w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    if w <= 0:
        return 0
    a = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / w
    b = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / w
    rows, columns = shapes[0, 1], shapes[0, 2]
    greatest = 0.0
    for axis in range(2):
        u = (matrix[0, axis] - a * matrix[2, axis]) / w * columns
        v = (matrix[1, axis] - b * matrix[2, axis]) / w * rows
        greatest = max(greatest, u * u + v * v)
    return max(min(int(0.5 * np.log2(greatest + 1e-12) + 0.5), count - 1), 0)


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _between(texels, at, stride, fu, fv):  # type: ignore[no-untyped-def]
    """The texel at index `at` and its three neighbours, interpolated linearly."""
    p00, p01 = np.float32(texels[at]), np.float32(texels[at + 1])
    p10, p11 = np.float32(texels[at + stride]), np.float32(texels[at + stride + 1])
    upper = p00 + (p01 - p00) * fu
    lower = p10 + (p11 - p10) * fu
    return upper + (lower - upper) * fv


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _fill_single(matrix, shape, scale, texels, left, top, right, bottom, radiance):  # type: ignore[no-untyped-def]
    """Add the one surface that a tile sees. First where, then what: the compiler vectorises the first loop."""
    offset, stride = np.int32(shape[0]), np.int32(shape[2] + 1)
    rows, columns = np.float32(shape[1]), np.float32(shape[2])
    half, zero = np.float32(0.5), np.float32(0.0)
    da, db, dw = np.float32(matrix[0, 0]) * columns, np.float32(matrix[1, 0]) * rows, np.float32(matrix[2, 0])
    at = np.empty(TILE_WIDTH, np.int32)
    fu, fv = np.empty(TILE_WIDTH, np.float32), np.empty(TILE_WIDTH, np.float32)
    for y in range(top, bottom):
        a = np.float32(matrix[0, 0] * left + matrix[0, 1] * y + matrix[0, 2]) * columns
        b = np.float32(matrix[1, 0] * left + matrix[1, 1] * y + matrix[1, 2]) * rows
        w = np.float32(matrix[2, 0] * left + matrix[2, 1] * y + matrix[2, 2])
        for x in range(right - left):
            step = np.float32(np.int32(x))
            depth = np.float32(1.0) / (w + dw * step)
            u = max((a + da * step) * depth - half, zero)
            v = max((b + db * step) * depth - half, zero)
            column, row = np.int32(u), np.int32(v)
            fu[x], fv[x] = u - np.float32(column), v - np.float32(row)
            at[x] = offset + row * stride + column
        for x in range(right - left):
            radiance[y, left + x] += scale * _between(texels, at[x], stride, fu[x], fv[x])


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _fill_nearest(matrices, shapes, scales, texels, found, left, top, right, bottom, radiance):  # type: ignore[no-untyped-def]
    """Add, pixel by pixel, the nearest of the surfaces `found` in a tile."""
    for y in range(top, bottom):
        for x in range(left, right):
            nearest, best, best_a, best_b = -1, 0.0, 0.0, 0.0
            for i in range(len(found)):
                m = matrices[found[i]]
                w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
                if w <= best:
                    continue
                a = m[0, 0] * x + m[0, 1] * y + m[0, 2]
                b = m[1, 0] * x + m[1, 1] * y + m[1, 2]
                if 0 <= a <= w and 0 <= b <= w:
                    nearest, best, best_a, best_b = i, w, a, b
            if nearest >= 0:
                offset, rows, columns = shapes[nearest, 0], shapes[nearest, 1], shapes[nearest, 2]
                u, v = max(best_a / best * columns - 0.5, 0.0), max(best_b / best * rows - 0.5, 0.0)
                column, row = np.int32(u), np.int32(v)
                at = offset + row * (columns + 1) + column
                texel = _between(texels, at, columns + 1, np.float32(u - column), np.float32(v - row))
                radiance[y, x] += scales[found[nearest]] * texel


@njit(cache=True, nogil=True)
def _render(matrices, scales, texels, levels, counts, radiance):  # type: ignore[no-untyped-def]
    """Sum of scale times texel over the poses, tile by tile."""
    height, width = radiance.shape
    radiance[:] = 0.0
    surfaces = matrices.shape[1]
    found = np.empty(surfaces, np.int64)
    nearer = np.empty(surfaces)
    shapes = np.empty((surfaces, 3), np.int64)
    for pose in range(len(matrices)):
        visible = np.empty(surfaces, np.int64)
        seen = 0
        for s in range(surfaces):
            if _cover(matrices[pose, s], 0, 0, width - 1, height - 1)[0] > 0:
                visible[seen] = s
                seen += 1
        for top in range(0, height, TILE_HEIGHT):
            bottom = min(top + TILE_HEIGHT, height)
            for left in range(0, width, TILE_WIDTH):
                right = min(left + TILE_WIDTH, width)
                number, behind = 0, 0.0
                for i in range(seen):
                    s = visible[i]
                    cover, least, greatest = _cover(matrices[pose, s], left, top, right - 1, bottom - 1)
                    # Nothing shows through a surface that covers the whole tile.
                    if cover > 0 and greatest > behind:
                        found[number], nearer[number] = s, greatest
                        number += 1
                    if cover == 2:
                        behind = max(behind, least)
                kept = 0
                for i in range(number):
                    if nearer[i] >= behind:
                        s = found[i]
                        found[kept] = s
                        x, y = (left + right) * 0.5, (top + bottom) * 0.5
                        level = _level(matrices[pose, s], x, y, levels[s], counts[s])
                        shapes[kept] = levels[s, level]
                        kept += 1
                if kept == 1 and behind > 0:
                    s = found[0]
                    _fill_single(matrices[pose, s], shapes[0], scales[s], texels, left, top, right, bottom, radiance)
                else:
                    _fill_nearest(
                        matrices[pose], shapes, scales, texels, found[:kept], left, top, right, bottom, radiance
                    )
