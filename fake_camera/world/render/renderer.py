"""Renders textured rectangles fast enough for a live camera, still or moving."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fake_camera.world.render.raster import pixel_matrices, rasterise
from fake_camera.world.render.smear import BLOCK, MARGIN, projection, smear

_NO_BLOCKS = np.empty((0, 0))


@dataclass(frozen=True, slots=True)
class Pinhole:
    """An ideal camera: size in pixels and focal length in pixels, the optical axis through the middle."""

    width: int = 720
    height: int = 540
    focal_px: float = 860.0


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A rectangle that emits light; visible only from the side where `edge_u` goes right and `edge_v` goes down.

    Attributes
    ----------
    corner, edge_u, edge_v
        Upper left corner and the two edges in world metres, shape (3,).
    pattern
        Its radiance in lux times reflectance, shape (rows, columns), float32: per lux of the room's light with
        `follows_light`, else absolute.
    follows_light
        Whether its radiance is in proportion to the room's light.
    """

    corner: NDArray[np.float64]
    edge_u: NDArray[np.float64]
    edge_v: NDArray[np.float64]
    pattern: NDArray[np.float32]
    follows_light: bool = True


class Renderer:
    """Renders surfaces as seen by one camera; each call overwrites the result of the one before."""

    def __init__(self, surfaces: Sequence[Surface], camera: Pinhole) -> None:
        self.camera = camera
        self.surfaces = surfaces
        self._lens = camera.focal_px, (camera.width - 1) / 2, (camera.height - 1) / 2
        self._corners = np.array([[s.corner, s.edge_u, s.edge_v] for s in surfaces])
        self._follows_light = np.array([s.follows_light for s in surfaces])
        self._texels, self._levels, self._counts, self._scales = _pack([s.pattern for s in surfaces])
        self._radiance = np.empty((camera.height, camera.width), np.float32)
        self._wide = np.empty((camera.height + 2 * MARGIN, camera.width + 2 * MARGIN), np.float32)
        self._sums = np.empty(self._wide.size, np.int32)
        self._nearness = np.empty((camera.height, -(-camera.width // BLOCK)))

    def of_numbers(self) -> Renderer:
        """A renderer of the surfaces' numbers, from 1 on, instead of their radiance; 0 where there is none."""
        numbered = [
            replace(surface, pattern=np.full((2, 2), number, np.float32), follows_light=False)
            for number, surface in enumerate(self.surfaces, 1)
        ]
        return Renderer(numbered, self.camera)

    def render(self, poses: NDArray[np.float64], lux: float | NDArray[np.float64]) -> NDArray[np.float32]:
        """Mean radiance over the poses, in lux times reflectance; it is affine in `lux`.

        Parameters
        ----------
        poses
            Camera poses during the exposure, camera to world, shape (poses, 4, 4).
        lux
            Mean illumination by the room's light during the exposure; or one for each surface, shape (surfaces,).

        Returns
        -------
        Shape (height, width), float32.
        """
        for index, pose in enumerate(poses):
            self._instant(pose, self._radiance, lux=lux, share=1.0 / len(poses), add=index > 0)
        return self._radiance

    def render_motion(self, poses: NDArray[np.float64], lux: float) -> NDArray[np.float32]:
        """Mean radiance while the camera moves, at the cost of one instant for each part of the motion.

        Parameters
        ----------
        poses
            At the beginning, in the middle and at the end of each part, camera to world, shape (parts, 3, 4, 4). No
            part may move the image by more than `smear.LONGEST_PX`: a longer motion is blurred by that much.
        lux
            As for `render`, which from many poses gives the same image except for the errors of `smear`.

        Returns
        -------
        Shape (height, width), float32.
        """
        share = np.float32(1.0 / len(poses))
        brightest = np.float32(65535 * self._scales_at(lux).max())
        for index, (begin, middle, end) in enumerate(poses):
            self._instant(middle, self._wide, lux=lux, margin=MARGIN, nearness=self._nearness)
            ends = projection(middle, begin, *self._lens), projection(middle, end, *self._lens)
            smear(self._wide, self._nearness, ends, brightest, share, self._sums, self._radiance, index > 0)
        return self._radiance

    def _instant(
        self,
        pose: NDArray[np.float64],
        radiance: NDArray[np.float32],
        *,
        lux: float | NDArray[np.float64],
        share: float = 1.0,
        add: bool = False,
        margin: int = 0,
        nearness: NDArray[np.float64] = _NO_BLOCKS,
    ) -> None:
        """Write or add a share of one instant to `radiance`, which has a margin, and record how near things are."""
        matrices = pixel_matrices(self._corners, pose, *self._lens)
        scales = (share * self._scales_at(lux)).astype(np.float32)
        rasterise(matrices, scales, self._texels, self._levels, self._counts, margin, radiance, add, nearness)

    def _scales_at(self, lux: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance of one texel step, by surface."""
        return self._scales * np.where(self._follows_light, lux, 1.0)


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
