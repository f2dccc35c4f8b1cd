"""The motion between two frames from matches with outliers: as many degrees of freedom as the camera has."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

HYPOTHESES = 200
"""Of two matches each: with a fifth of the matches right, 99.97 % that one of them is of right matches only."""

_REFINEMENTS = 2
"""Least squares over the inliers, and over those of its result."""

Homography = NDArray[np.float64]
Points = NDArray[np.float64]


class MotionModel(Protocol):
    """A family of homographies that two matches determine; all points are (..., 2) in pixels."""

    def through(self, here: Points, there: Points) -> Homography:
        """The homographies (n, 3, 3) of n samples of two matches each, (n, 2, 2); NaN or infinite for a useless one."""

    def fitted(self, here: Points, there: Points) -> Homography:
        """The homography (3, 3) of least squares for at least two matches (m, 2)."""


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
    """Of a turning camera.

    Parameters
    ----------
    camera
        Its matrix K, (3, 3).
    """

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

    def _rays(self, points: Points) -> NDArray[np.float64]:
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


def _apart(motions: Homography, here: Points, there: Points) -> NDArray[np.float64]:
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


def _triads(rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Orthonormal axes, in columns, of two rays each: (n, 2, 3) -> (n, 3, 3)."""
    middle = rays[:, 0] + rays[:, 1]
    across = np.cross(rays[:, 0], rays[:, 1])
    first, second = (axis / np.linalg.norm(axis, axis=-1, keepdims=True) for axis in (middle, across))
    return np.stack([first, second, np.cross(first, second)], axis=-1)
