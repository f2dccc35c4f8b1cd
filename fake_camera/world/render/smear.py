"""Motion blur from one rendered instant: every pixel is averaged along the motion of the image there.

How the image moves follows from the camera's poses and from the depth seen at each place. The average along the row is
a difference of two running sums, so that it costs the same at any length. It differs from the mean over many
instants at edges of near things, behind which a moving camera uncovers what one instant does not show, and by the
curvature of the motion. `tests/fake_camera/world/test_render.py` checks by how much.
"""

# Compiled kernels take plain arrays and numbers, by position:
# ruff: noqa: PLR0917

from __future__ import annotations

import numpy as np

from fake_camera.world.compiled import compiled

BLOCK = 32
"""Pixels of a row that share one motion."""

MARGIN = 12
"""Pixels rendered beyond each edge of the image, since motion brings them in."""

LONGEST_PX = 2 * MARGIN - 3
"""The longest motion that the margin allows; longer ones are cut to it."""

_STEADY_PX = 0.3
"""Motion across the rows is averaged in parts of at most a pixel; this much is neglected."""

_LARGEST_SUM = 2.0**30
"""For the brightest pixels over the longest motion: running sums may overflow, their differences must not."""


@compiled()
def projection(middle, pose, focal, centre_x, centre_y):  # type: ignore[no-untyped-def]
    """Where a camera at `pose` sees what one at `middle` sees at pixel (x, y) and depth z.

    Returns the 3x4 matrix that takes (x, y, 1, 1 / z) to homogeneous pixels; poses are camera to world, 4x4.
    """
    result = np.zeros((3, 4))
    for i in range(3):
        for j in range(4):
            for axis in range(3):
                apart = middle[axis, j] - (pose[axis, 3] if j == 3 else 0.0)
                result[i, j] += pose[axis, i] * apart
    # From rays and points to pixels, for both cameras.
    result[0] = focal * result[0] + centre_x * result[2]
    result[1] = focal * result[1] + centre_y * result[2]
    for i in range(3):
        result[i, 0] /= focal
        result[i, 1] /= focal
        result[i, 2] -= centre_x * result[i, 0] + centre_y * result[i, 1]
    return result


@compiled()
def smear(rendered, nearness, ends, brightest, share, sums, radiance, add):  # type: ignore[no-untyped-def]
    """Write `share` of an image to `radiance`, or add it when `add`, blurred by a motion.

    `rendered` is the image with `MARGIN`, at most `brightest` everywhere; `nearness` is 1 / z by row and block; `ends`
    are the projections at either end of the motion. Images are float32, `share` and `brightest` too; `sums` is scratch
    space, one int32 for each pixel of `rendered`.
    """
    height, width = radiance.shape
    blocks, stride = nearness.shape[1], rendered.shape[1]
    motion_x, motion_y = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    total = np.empty(BLOCK, np.float32)
    step = np.float32(brightest * LONGEST_PX / _LARGEST_SUM)
    _running_sums(rendered, step, sums)
    flat = rendered.reshape(-1)
    for y in range(height):
        _motion(ends[0], ends[1], y, nearness, motion_x, motion_y)
        for block in range(blocks):
            x = block * BLOCK
            used = min(BLOCK, width - x)
            at = (y + MARGIN) * stride + x + MARGIN
            if max(abs(motion_x[block]), abs(motion_y[block])) <= 1.0:
                for i in range(used):
                    total[i] = flat[np.uint64(at + i)]
            else:
                total[:] = 0.0
                _average(flat, sums, step, at, stride, motion_x[block], motion_y[block], total)
            for i in range(used):
                radiance[y, x + i] = share * total[i] + (radiance[y, x + i] if add else np.float32(0.0))


@compiled(fastmath=True, error_model="numpy")
def _running_sums(rendered, step, sums):  # type: ignore[no-untyped-def]
    """Sum of all pixels to the left in the same row, in steps; it may overflow."""
    height, width = rendered.shape
    per_step = np.float32(1.0) / step
    for y in range(height):
        total = np.int32(0)
        for x in range(width):
            sums[y * width + x] = total
            total = np.int32(total + np.int32(rendered[y, x] * per_step))


@compiled(fastmath=True, error_model="numpy")
def _motion(begin, end, y, nearness, motion_x, motion_y):  # type: ignore[no-untyped-def]
    """How far the image moves in each block of a row, in pixels."""
    limit = np.float32(LONGEST_PX)
    for block in range(motion_x.size):
        x, w = np.float64(block * BLOCK + BLOCK // 2), nearness[y, block]
        z0 = begin[2, 0] * x + begin[2, 1] * y + begin[2, 2] + begin[2, 3] * w
        z1 = end[2, 0] * x + end[2, 1] * y + end[2, 2] + end[2, 3] * w
        x0 = (begin[0, 0] * x + begin[0, 1] * y + begin[0, 2] + begin[0, 3] * w) / z0
        x1 = (end[0, 0] * x + end[0, 1] * y + end[0, 2] + end[0, 3] * w) / z1
        y0 = (begin[1, 0] * x + begin[1, 1] * y + begin[1, 2] + begin[1, 3] * w) / z0
        y1 = (end[1, 0] * x + end[1, 1] * y + end[1, 2] + end[1, 3] * w) / z1
        motion_x[block] = min(max(np.float32(x1 - x0), -limit), limit)
        motion_y[block] = min(max(np.float32(y1 - y0), -limit), limit)


@compiled(fastmath=True, error_model="numpy")
def _average(flat, sums, step, at, stride, motion_x, motion_y, total):  # type: ignore[no-untyped-def]
    """Add the mean along a motion to a block of pixels that begins at index `at`.

    The motion is cut into parts that each stay in one row, or between two: a box along the row, interpolated across it.
    """
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    parts = 1 + np.int64(np.ceil(max(abs(motion_y) - np.float32(_STEADY_PX), zero)))
    length = max(abs(motion_x) / np.float32(parts), one)
    for part in range(parts):
        place = (np.float32(part) + half) / np.float32(parts) - half
        low = place * motion_x - half * length + half  # the edges of the box, in pixels from the first one's left edge
        high = low + length
        first, last = np.int64(np.floor(low)), np.int64(np.floor(high))
        row = np.int64(np.floor(place * motion_y))
        lower = place * motion_y - np.float32(row)
        for of_row, share in ((row, one - lower), (row + 1, lower)):
            if share == zero:
                continue
            weight = share / (np.float32(parts) * length)
            per_sum = weight * step
            per_first, per_last = weight * (low - np.float32(first)), weight * (high - np.float32(last))
            a, b = np.uint64(at + of_row * stride + first), np.uint64(at + of_row * stride + last)
            for i in range(BLOCK):
                j = np.uint64(i)  # unsigned, so that numba does not ask whether it counts from the end
                inside = np.float32(np.int32(sums[b + j] - sums[a + j]))
                total[i] += per_sum * inside + per_last * flat[b + j] - per_first * flat[a + j]
