"""Which textured rectangle is visible at each pixel: plain loops over tiles and rows, compiled by numba.

A rectangle seen by a pinhole camera is one 3x3 matrix: with corner O and edges U, V in camera coordinates, pixel p lies
at (a, b) of the rectangle and at depth z where (a, b, 1) / z = [U V O]^-1 K^-1 p. All three are linear in the pixel, so
a test at the four corners of a tile holds for the whole tile, most tiles see a single rectangle, and in a row each
rectangle is one span.
"""

# Compiled kernels take plain arrays and numbers, by position:
# ruff: noqa: PLR0917

from __future__ import annotations

import numpy as np

from fake_camera.world.compiled import compiled
from fake_camera.world.render.smear import BLOCK

TILE_WIDTH, TILE_HEIGHT = 128, 18

_SEAM_PX = 1e-6
"""Surfaces are extended by this much, so that no gap opens between two that share an edge."""


@compiled()
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled()
def pixel_matrices(corners, pose, focal, centre_x, centre_y):  # type: ignore[no-untyped-def]
    """Pixel to (a, b, 1) / z by surface, shape (surfaces, 3, 3); 0 for surfaces seen from behind."""
    matrices = np.zeros((len(corners), 3, 3))
    seen, rows = np.empty((3, 3)), np.empty((3, 3))
    for s in range(len(corners)):
        for i in range(3):
            for axis in range(3):
                total = 0.0
                for j in range(3):
                    total += pose[j, axis] * (corners[s, i, j] - (pose[j, 3] if i == 0 else 0.0))
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
            matrices[s, i, 0] = a
            matrices[s, i, 1] = b
            matrices[s, i, 2] = rows[i, 2] / determinant - a * centre_x - b * centre_y
    return matrices


@compiled()
def _cover(matrix, left, top, right, bottom):  # type: ignore[no-untyped-def]
    """How a surface covers a tile: 0 not, 1 perhaps partly, 2 wholly; and its lowest and highest 1 / z there."""
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


@compiled()
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


@compiled(error_model="numpy")
def _span(matrix, y, left, right):  # type: ignore[no-untyped-def]
    """Where a surface begins and ends in a row of a tile, as [begin, end) within [left, right)."""
    begin, end = left, right
    a = matrix[0, 0] * left + matrix[0, 1] * y + matrix[0, 2]
    b = matrix[1, 0] * left + matrix[1, 1] * y + matrix[1, 2]
    w = matrix[2, 0] * left + matrix[2, 1] * y + matrix[2, 2]
    da, db, dw = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    beyond = np.float64(right - left)
    for value, slope in ((a, da), (w - a, dw - da), (b, db), (w - b, dw - db)):
        if slope == 0.0:
            if value < 0.0:
                return left, left
            continue
        edge = min(max(-value / slope, -1.0), beyond)
        if slope > 0.0:
            begin = max(begin, left + np.int64(np.ceil(edge - _SEAM_PX)))
        else:
            end = min(end, left + np.int64(np.floor(edge + _SEAM_PX)) + 1)
    return begin, end


@compiled(error_model="numpy")
def _nearest(matrices, found, spans, x, y, right):  # type: ignore[no-untyped-def]
    """Which of the surfaces `found` is the nearest at (x, y), -1 for none, and up to which x that is certain."""
    best, best_w, best_slope, until = -1, 0.0, 0.0, right
    for i in range(len(found)):
        if spans[i, 0] > x:
            until = min(until, spans[i, 0])
        elif spans[i, 1] > x:
            m = matrices[found[i]]
            w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
            if w > best_w:
                best, best_w, best_slope = i, w, m[2, 0]
    if best < 0:
        return best, until
    for i in range(len(found)):
        if spans[i, 0] <= x < spans[i, 1]:
            m = matrices[found[i]]
            if m[2, 0] > best_slope:  # surfaces that cross: this one comes nearer towards the right
                w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
                crossing = (best_w - w) / (m[2, 0] - best_slope)
                until = min(until, x + 1 + np.int64(min(crossing, np.float64(right - x))))
    return best, min(until, spans[best, 1])


@compiled(fastmath=True, error_model="numpy")
def _fill(matrix, shape, scale, texels, x, y, until, margin, at, fu, fv, radiance, add):  # type: ignore[no-untyped-def]
    """Write or add one surface in a row from x to `until`: first the addresses, in a loop that vectorises."""
    offset, stride = np.uint32(shape[0]), np.uint32(shape[2] + 1)
    rows, columns = np.float32(shape[1]), np.float32(shape[2])
    half, zero = np.float32(0.5), np.float32(0.0)
    da, db, dw = np.float32(matrix[0, 0]) * columns, np.float32(matrix[1, 0]) * rows, np.float32(matrix[2, 0])
    a = np.float32(matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) * columns
    b = np.float32(matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) * rows
    w = np.float32(matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2])
    for i in range(until - x):
        step = np.float32(np.int32(i))
        depth = np.float32(1.0) / (w + dw * step)
        # Rounding may lead a little beyond the edges.
        u = min(max((a + da * step) * depth - half, zero), columns - half)
        v = min(max((b + db * step) * depth - half, zero), rows - half)
        column, line = np.int32(u), np.int32(v)
        fu[i], fv[i] = u - np.float32(column), v - np.float32(line)
        at[i] = offset + np.uint32(line) * stride + np.uint32(column)
    line_at, left = y + margin, x + margin
    for i in range(until - x):
        above = np.uint64(at[i])  # unsigned, so that numba does not ask whether it counts from the end
        below = above + np.uint64(stride)
        p00, p01 = np.float32(texels[above]), np.float32(texels[above + np.uint64(1)])
        p10, p11 = np.float32(texels[below]), np.float32(texels[below + np.uint64(1)])
        upper = p00 + (p01 - p00) * fu[i]
        lower = p10 + (p11 - p10) * fu[i]
        texel = scale * (upper + (lower - upper) * fv[i])
        radiance[line_at, left + i] = texel + (radiance[line_at, left + i] if add else zero)


@compiled()
def _in_tile(matrices, visible, left, top, right, bottom, found, nearer):  # type: ignore[no-untyped-def]
    """Write to `found` which of the visible surfaces may show in a tile.

    Returns how many, and whether it is a single one that covers the whole tile.
    """
    number, behind = 0, 0.0
    for s in visible:
        cover, least, greatest = _cover(matrices[s], left, top, right - 1, bottom - 1)
        # Nothing shows through a surface that covers the whole tile.
        if cover > 0 and greatest > behind:
            found[number], nearer[number] = s, greatest
            number += 1
        if cover == 2:
            behind = max(behind, least)
    kept = 0
    for i in range(number):
        if nearer[i] >= behind:
            found[kept] = found[i]
            kept += 1
    return kept, kept == 1 and behind > 0.0


@compiled()
def rasterise(matrices, scales, texels, levels, counts, margin, radiance, add, nearness):  # type: ignore[no-untyped-def]
    """Write or add scale times texel for one pose, tile by tile, and record 1 / z in the middle of each block.

    Pixel (0, 0) of the camera is at [margin, margin] of `radiance`.
    """
    across, down = radiance.shape[1] - margin, radiance.shape[0] - margin
    surfaces = len(matrices)
    found, nearer = np.empty(surfaces, np.int64), np.empty(surfaces)
    shapes, spans = np.empty((surfaces, 3), np.int64), np.empty((surfaces, 2), np.int64)
    at, fu, fv = np.empty(TILE_WIDTH, np.uint32), np.empty(TILE_WIDTH, np.float32), np.empty(TILE_WIDTH, np.float32)
    everything, nowhere = np.arange(surfaces), np.zeros((3, 3))
    seen, _ = _in_tile(matrices, everything, -margin, -margin, across, down, found, nearer)
    visible = found[:seen].copy()
    for top in range(-margin, down, TILE_HEIGHT):
        bottom = min(top + TILE_HEIGHT, down)
        for left in range(-margin, across, TILE_WIDTH):
            right = min(left + TILE_WIDTH, across)
            kept, covered = _in_tile(matrices, visible, left, top, right, bottom, found, nearer)
            for i in range(kept):
                s = found[i]
                level = _level(matrices[s], (left + right) * 0.5, (top + bottom) * 0.5, levels[s], counts[s])
                shapes[i] = levels[s, level]
            for y in range(top, bottom):
                for i in range(kept):
                    spans[i] = (left, right) if covered else _span(matrices[found[i]], y, left, right)
                x = left
                while x < right:
                    i, until = (0, right) if covered else _nearest(matrices, found[:kept], spans, x, y, right)
                    matrix = nowhere if i < 0 else matrices[found[i]]
                    if i >= 0:
                        scale = scales[found[i]]
                        _fill(matrix, shapes[i], scale, texels, x, y, until, margin, at, fu, fv, radiance, add)
                    elif not add:
                        radiance[y + margin, x + margin : until + margin] = 0.0
                    if 0 <= y < len(nearness):
                        _note(matrix, x, y, until, nearness)
                    x = until


@compiled()
def _note(matrix, x, y, until, nearness):  # type: ignore[no-untyped-def]
    """Record 1 / z of a surface in those blocks of row y whose middle is within [x, until)."""
    block = max((x + BLOCK // 2 - 1) // BLOCK, 0)
    while block < nearness.shape[1] and block * BLOCK + BLOCK // 2 < until:
        nearness[y, block] = matrix[2, 0] * (block * BLOCK + BLOCK // 2) + matrix[2, 1] * y + matrix[2, 2]
        block += 1
