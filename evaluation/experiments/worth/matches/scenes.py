"""Pictures with real or painted radiance, seen by a moving camera, and its motion found from matches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.arrays import Floats, Floats32
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.scenes.stills import picture

# Of two matches each: with a fifth of the matches right, 99.97 % that one of them is of right matches only.
HYPOTHESES = 200
_REFINEMENTS = 2  # Least squares over the inliers, and over those of its result
Homography = Floats
Points = Floats


class MotionModel(Protocol):
    """A family of homographies that two matches determine; all points are (..., 2) in pixels."""

    def through(self, here: Points, there: Points) -> Homography:
        """The homographies (n, 3, 3) of n samples of two matches each, (n, 2, 2); NaN or infinite for a useless one."""

    def fitted(self, here: Points, there: Points) -> Homography:
        """The homography (3, 3) of least squares for at least two matches (m, 2)."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueMotion:
    """What is known of the motion between two frames."""

    homography: Homography  # takes pixels of the first to those of the second, (3, 3)
    model: MotionModel  # the family that it is from


class Similarity:
    """Of a plane parallel to the image: shift, turn and size."""

    def through(self, here: Points, there: Points) -> Homography:
        """See `MotionModel`."""
        first, second = _complex(here), _complex(there)
        with np.errstate(invalid="ignore", divide="ignore"):
            turn = (second[:, 1] - second[:, 0]) / (first[:, 1] - first[:, 0])
            return _similarity(turn, second[:, 0] - turn * first[:, 0])

    def fitted(self, here: Points, there: Points) -> Homography:
        """See `MotionModel`."""
        first, second = _complex(here), _complex(there)
        off, off_there = first - first.mean(), second - second.mean()
        with np.errstate(invalid="ignore", divide="ignore"):
            turn = (off.conj() * off_there).sum() / (np.abs(off) ** 2).sum()
        return _similarity(turn, second.mean() - turn * first.mean())


class Rotation:
    """Of a turning camera. `camera`: its matrix K, (3, 3)."""

    def __init__(self, camera: Homography) -> None:
        self._camera, self._inverse = camera, np.linalg.inv(camera)

    def through(self, here: Points, there: Points) -> Homography:
        """See `MotionModel`."""
        with np.errstate(invalid="ignore", divide="ignore"):
            turns = _triads(self._rays(there)) @ np.swapaxes(_triads(self._rays(here)), -1, -2)
        return np.asarray(self._camera @ turns @ self._inverse)

    def fitted(self, here: Points, there: Points) -> Homography:
        """See `MotionModel`: Kabsch's solution."""
        u, _, vt = np.linalg.svd(self._rays(there).T @ self._rays(here))
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        return np.asarray(self._camera @ turn @ self._inverse)

    def _rays(self, points: Points) -> Floats:
        rays = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ self._inverse.T
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def found_motion(model: MotionModel, here: Points, there: Points, within_px: float) -> Homography | None:
    """RANSAC: the homography that most matches (n, 2) agree with, refined on them; None for fewer than two."""
    if len(here) < 2:
        return None
    samples = np.random.default_rng(0).integers(0, len(here), (HYPOTHESES, 2))
    tried = model.through(here[samples], there[samples])
    agree = _apart(tried, here, there) <= within_px
    inside = agree[agree.sum(axis=1).argmax()]
    found = None
    for _ in range(_REFINEMENTS):
        if inside.sum() < 2:
            break
        found = model.fitted(here[inside], there[inside])
        inside = _apart(found[None], here, there)[0] <= within_px
    return found


def _apart(motions: Homography, here: Points, there: Points) -> Floats:
    """How far matches are from what motions (m, 3, 3) say, (m, n); NaN for a useless motion."""
    homogeneous = np.concatenate([here, np.ones((len(here), 1))], axis=1)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        moved = homogeneous @ np.swapaxes(motions, -1, -2)
        off = moved[..., :2] / moved[..., 2:] - there
        return np.asarray(np.sqrt((off**2).sum(axis=-1)))


def _complex(points: Points) -> NDArray[np.complex128]:
    return np.asarray(points[..., 0] + 1j * points[..., 1])


def _similarity(turn: NDArray[np.complex128], shift: NDArray[np.complex128]) -> Homography:
    """z -> turn z + shift as matrices, (..., 3, 3)."""
    zero, one = np.zeros_like(turn.real), np.ones_like(turn.real)
    rows = [(turn.real, -turn.imag, shift.real), (turn.imag, turn.real, shift.imag), (zero, zero, one)]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _triads(rays: Floats) -> Floats:
    """Orthonormal axes, in columns, of two rays each: (n, 2, 3) -> (n, 3, 3)."""
    middle = rays[:, 0] + rays[:, 1]
    across = np.cross(rays[:, 0], rays[:, 1])
    first, second = (axis / np.linalg.norm(axis, axis=-1, keepdims=True) for axis in (middle, across))
    return np.stack([first, second, np.cross(first, second)], axis=-1)


WIDTH, HEIGHT = 360, 270  # Of the judged frames: panoramas of 1024x512 have no more detail to show
DISPARITY_PX = 12  # Between the cameras; everything is at one distance
# Width and height of what both cameras see together; the left one sees its left end.
CANVAS = (WIDTH + DISPARITY_PX, HEIGHT)
CENTRE = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)  # The left camera's principal point (pixels)
# Before panoramas: 90 degrees across, where a pixel of the view is about as large as one of the panorama.
FOCAL_PX = 180.0
STILL_SPAN = 1.8  # Larger stills are shrunk to this many views across or down: sharp, and no view shows nothing but sky
_PANORAMAS = "hdri_1k_cc0/"
_MARGIN_PX = 64  # By which panoramas continue beyond their seam
Radiance = Floats32


class MovingView(Protocol):
    """What the canvas shows at an instant."""

    @property
    def model(self) -> MotionModel:
        """The family of `homography`."""

    def radiance(self, time_s: float) -> Radiance:
        """Radiance per lux, float32, (HEIGHT, CANVAS[0]), not negative."""

    def homography(self, from_s: float, to_s: float) -> Homography:
        """Takes pixels of the left image at one instant to those at another, (3, 3)."""


class MovingStill:
    """A still on a plane; the camera moves along a circle parallel to it, rolls a little, and comes and goes. If it
    pans, along a flat ellipse instead, from one side of the still to the other and back. `still`: radiance per lux,
    (rows, columns); one of its pixels is about one of the view. `speed_px`: of the image, in pixels of the view per
    1/60 s. `seed`: decides where the circle lies."""

    def __init__(self, still: Radiance, speed_px: float, seed: int, *, pan: bool = False) -> None:
        self.model: MotionModel = Similarity()
        self._still = still
        rng = np.random.default_rng([seed, 17])
        # What the view needs to either side of its centre, with its roll and its changes of size.
        room = np.array(still.shape[::-1]) / 2 - 0.55 * np.array(CANVAS) - 0.05 * np.array(CANVAS[::-1]) / 2
        radius = float(np.clip(room.min(), 30.0, 200.0))
        self._radii = np.array([max(float(room[0]), 30.0), 10.0]) if pan else np.array([radius, radius])
        spare = np.maximum(room - self._radii, 0.0)
        self._middle = np.array(still.shape[::-1]) / 2 + rng.uniform(-1.0, 1.0, 2) * spare
        self._phase = float(rng.uniform(0.0, 2 * math.pi))
        self._rate = speed_px * RATE_HZ / self._radii[0]

    def radiance(self, time_s: float) -> Radiance:
        """See `MovingView`."""
        seen = cv2.warpAffine(
            self._still,
            self._to_still(time_s)[:2],
            CANVAS,
            flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REFLECT,
        )
        return np.maximum(seen, np.float32(0.0), out=seen)

    def homography(self, from_s: float, to_s: float) -> Homography:
        """See `MovingView`."""
        return np.asarray(np.linalg.inv(self._to_still(to_s)) @ self._to_still(from_s), np.float64)

    def _to_still(self, time_s: float) -> Homography:
        """From pixels of the left image to pixels of the still."""
        gone = self._rate * time_s
        x, y = self._middle + self._radii * np.array([math.cos(gone + self._phase), math.sin(gone + self._phase)])
        roll, size = 0.05 * math.sin(0.7 * gone), 1.0 + 0.04 * math.sin(0.5 * gone)
        cos, sin = size * math.cos(roll), size * math.sin(roll)
        about = np.array([[1.0, 0.0, -CENTRE[0]], [0.0, 1.0, -CENTRE[1]], [0.0, 0.0, 1.0]])
        return np.asarray(np.array([[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]]) @ about, np.float64)


class TurningPanorama:
    """A panorama all around a camera that turns, nods and rolls. `panorama`: radiance per lux, equirectangular, (rows,
    columns). `speed_px`: of the middle of the image, in pixels of the view per 1/60 s. `seed`: decides where the camera
    looks first."""

    def __init__(self, panorama: Radiance, speed_px: float, seed: int) -> None:
        self._wide = cv2.copyMakeBorder(panorama, 0, 0, _MARGIN_PX, _MARGIN_PX, cv2.BORDER_WRAP)
        self._rows, self._columns = panorama.shape
        self._start = float(np.random.default_rng([seed, 18]).uniform(0.0, 2 * math.pi))
        self._rate = speed_px * RATE_HZ / FOCAL_PX
        x, y = np.meshgrid(np.arange(CANVAS[0]) - CENTRE[0], np.arange(CANVAS[1]) - CENTRE[1])
        rays = np.stack([x.ravel(), y.ravel(), np.full(x.size, FOCAL_PX)])
        self._rays = (rays / np.linalg.norm(rays, axis=0)).astype(np.float32)
        self._camera = np.array([[FOCAL_PX, 0.0, CENTRE[0]], [0.0, FOCAL_PX, CENTRE[1]], [0.0, 0.0, 1.0]])
        self.model: MotionModel = Rotation(self._camera)

    def radiance(self, time_s: float) -> Radiance:
        """See `MovingView`."""
        x, y, z = self._to_world(time_s).astype(np.float32) @ self._rays
        across = np.arctan2(x, z) / np.float32(2 * math.pi) + np.float32(0.5)
        down = np.arcsin(np.clip(y, -1.0, 1.0)) / np.float32(math.pi) + np.float32(0.5)
        map_x = (across * np.float32(self._columns) + np.float32(_MARGIN_PX - 0.5)).reshape(CANVAS[::-1])
        map_y = (down * np.float32(self._rows) - np.float32(0.5)).reshape(CANVAS[::-1])
        seen = cv2.remap(self._wide, map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.maximum(seen, np.float32(0.0), out=seen)

    def homography(self, from_s: float, to_s: float) -> Homography:
        """See `MovingView`."""
        turn = self._to_world(to_s).T @ self._to_world(from_s)
        return np.asarray(self._camera @ turn @ np.linalg.inv(self._camera), np.float64)

    def _to_world(self, time_s: float) -> Floats:
        gone = self._rate * time_s
        yaw, pitch, roll = self._start + gone, 0.15 * math.sin(0.9 * gone), 0.05 * math.sin(1.3 * gone)
        turned = [cv2.Rodrigues(np.array(axis))[0] for axis in ((0.0, yaw, 0.0), (pitch, 0.0, 0.0), (0.0, 0.0, roll))]
        return np.asarray(turned[0] @ turned[1] @ turned[2], np.float64)


def is_panorama(scene: str) -> bool:
    """Whether one of the `pictures` goes all around."""
    return scene.startswith(_PANORAMAS)


def moving_view(scene: str, speed_px: float, seed: int, *, pan: bool = False) -> MovingView:
    """One of the `pictures`, by its name; only stills are panned, since before panoramas a camera turns anyway."""
    if is_panorama(scene):
        return TurningPanorama(_shrunk(scene), speed_px, seed)
    return MovingStill(_shrunk(scene), speed_px, seed, pan=pan)


def _shrunk(scene: str) -> Radiance:
    """A picture; photographed stills shrunk to `STILL_SPAN`."""
    found = picture(scene)
    if ":" in scene or is_panorama(scene):
        return found
    rows, columns = found.shape
    scale = STILL_SPAN * max(CANVAS[0] / columns, CANVAS[1] / rows)
    if scale >= 1.0:
        return found
    return np.asarray(cv2.resize(found, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.float32)
