"""Our own odometry: ORB features, stereo matches, PnP with RANSAC, and a robust refinement on both images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from evaluation.arrays import Flags, Floats, Greys
from evaluation.odometry.features import FeatureFinder, StereoFeatures, apart, match, place
from evaluation.odometry.stereo import StereoCamera, Tracked

RANSAC_ROUNDS = 200
RANSAC_ERROR_PX = 3.0
# Points with larger errors are outliers; 95 % of the good ones stay below, in two to three dimensions.
OUTLIER_SIGMAS = 2.8
IN_FRONT_M = 0.05  # Points nearer than this, or behind the camera, are not visible
ROUNDS = 10
DAMPING = 1e-3  # Keeps the equations solvable when all points are on a line; negligible otherwise


def transform(pose: Floats, points: Floats) -> Floats:
    """Points (n, 3) moved by a pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def project(camera: StereoCamera, points: Floats) -> Floats:
    """Where points (n, 3) are seen: column and row in the left image, column in the right one, shape (n, 3)."""
    depth = np.maximum(points[:, 2], 1e-6)
    x = camera.focal_px * points[:, 0] / depth + camera.centre_px[0]
    y = camera.focal_px * points[:, 1] / depth + camera.centre_px[1]
    return np.column_stack([x, y, x - camera.focal_px * camera.baseline_m / depth])


def triangulate(camera: StereoCamera, seen: Floats) -> Floats:
    """Points (n, 3) in the frame of the left camera from where they are seen, the inverse of `project`."""
    depth = camera.focal_px * camera.baseline_m / np.maximum(seen[:, 0] - seen[:, 2], 1e-3)
    x = (seen[:, 0] - camera.centre_px[0]) / camera.focal_px * depth
    y = (seen[:, 1] - camera.centre_px[1]) / camera.focal_px * depth
    return np.column_stack([x, y, depth])


def rough_pose(camera: StereoCamera, points: Floats, seen: Floats) -> Floats | None:
    """The pose that takes points (n, 3) to the left camera, by RANSAC from where it sees them (n, 2); None for none."""
    if len(points) < 6:
        return None
    matrix = np.array([[camera.focal_px, 0, camera.centre_px[0]], [0, camera.focal_px, camera.centre_px[1]], [0, 0, 1]])
    found, turn, shift, inliers = cv2.solvePnPRansac(
        points, np.ascontiguousarray(seen), matrix, np.zeros(4), iterationsCount=RANSAC_ROUNDS,
        reprojectionError=RANSAC_ERROR_PX, confidence=0.999, flags=cv2.SOLVEPNP_P3P,
    )  # fmt: skip
    if not found or inliers is None:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return pose


def refined_pose(
    camera: StereoCamera, pose: Floats, points: Floats, seen: Floats, sigmas: Floats
) -> tuple[Floats, Flags]:
    """The pose with the smallest robust error (Gauss-Newton with Huber's weights), and the points that agree with it.
    `points`: (n, 3), metres. `seen`: as `project` returns it; NaN where the right camera does not see a point.
    `sigmas`: precision of each position, pixels."""
    for _ in range(ROUNDS):
        local = transform(pose, points)
        error, length = _errors(camera, local, seen, sigmas)
        weight = np.minimum(1.0, OUTLIER_SIGMAS / np.maximum(length, 1e-9))
        weight = np.where(length > 4 * OUTLIER_SIGMAS, 0.0, weight) / sigmas**2
        slope = _slopes(camera, local)
        slope[np.isnan(seen)] = 0.0
        normal = np.einsum("n,nij,nik->jk", weight, slope, slope) + DAMPING * np.eye(6)
        step = np.linalg.solve(normal, np.einsum("n,nij,ni->j", weight, slope, error))
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = cv2.Rodrigues(step[3:])[0], step[:3]
        pose = moved @ pose
        if float(np.abs(step).max()) < 1e-7:
            break
    _, length = _errors(camera, transform(pose, points), seen, sigmas)
    return pose, length <= OUTLIER_SIGMAS


def _errors(camera: StereoCamera, local: Floats, seen: Floats, sigmas: Floats) -> tuple[Floats, Floats]:
    """Seen minus expected in pixels (0 where not seen), and its length in sigmas, infinite behind the camera."""
    error = np.nan_to_num(seen - project(camera, local))
    length = np.linalg.norm(error, axis=1) / sigmas
    return error, np.where(local[:, 2] > IN_FRONT_M, length, np.inf)


def _slopes(camera: StereoCamera, local: Floats) -> Floats:
    """How `project` changes with a small shift and turn of the points, shape (n, 3, 6)."""
    x, y = local[:, 0], local[:, 1]
    depth = np.maximum(local[:, 2], 1e-6)
    nothing = np.zeros_like(depth)
    by_x, by_y = camera.focal_px / depth, camera.focal_px / depth
    left = np.stack([by_x, nothing, -by_x * x / depth], axis=1)
    row = np.stack([nothing, by_y, -by_y * y / depth], axis=1)
    right = np.stack([by_x, nothing, -by_x * (x - camera.baseline_m) / depth], axis=1)
    by_point = np.stack([left, row, right], axis=1)
    # A turn w moves a point by w x p.
    by_turn = np.stack(
        [
            np.stack([nothing, local[:, 2], -y], axis=1),
            np.stack([-local[:, 2], nothing, x], axis=1),
            np.stack([y, -x, nothing], axis=1),
        ],
        axis=1,
    )
    return np.concatenate([by_point, by_point @ by_turn], axis=2)


KEYS = 3  # A pair is tied to this many key pairs and to the pair before it, so that their errors average out
# A pair becomes a key pair when it shares fewer points with the last one than this part of the most so far, or than
# `FEWEST_INLIERS`: one that nobody shares anything with is not the last for long.
STALE_SHARE = 0.6
FEWEST_INLIERS = 20  # Fewer points may agree on a motion by chance
USUAL_INTERVAL_S = 1 / 30  # Between pairs: what the next two hold for
LARGEST_JUMP_M, LARGEST_JUMP_RAD = 0.02, 0.1  # A pose farther than this from where the motion so far leads is an error
NEAR_PX = 90.0  # How far from its expected position a feature is looked for
REACH_PX = 2  # How far off ORB may place a feature: a pixel, times the scale of its pyramid level
PLACED_SIGMA = 0.4  # Of a point placed by its patch (pixels); three to four times its value in good light


@dataclass(frozen=True, slots=True, eq=False)
class _Key:
    """A pair that later ones are tied to: its features with depth, in its left image and in the first pair's frame."""

    image: Greys
    seen: Floats
    points: Floats
    descriptors: Greys


class OrbOdometry:
    """Ties each pair to the last key pairs; a `StereoOdometry`.

    The motion so far, continued at constant speed, says where to look for features. Matches are then placed to a
    fraction of a pixel by their patches. A pair that shares too little with earlier ones is lost: its pose is that
    guess, and it becomes a key pair, from which tracking continues; the next guess is rest.

    `seed`: of RANSAC's random choices. `interval_s`: between pairs, roughly: from one to the next as much more can
    change.

    `features_px`, `inliers_px`: where in the latest left image features were found, and where those that tie it to the
    last key pair: (n, 2)."""

    def __init__(self, camera: StereoCamera, seed: int = 0, interval_s: float = USUAL_INTERVAL_S) -> None:
        self._camera, self._seed = camera, seed
        self._reach = max(interval_s / USUAL_INTERVAL_S, 1.0)
        self._finder = FeatureFinder(camera)
        self._pose, self._motion = np.eye(4), np.eye(4)
        self._keys: list[_Key] = []
        self._before: _Key | None = None
        self._most_shared = 0
        self.features_px = self.inliers_px = np.empty((0, 2))

    def track(self, left: Greys, right: Greys) -> Tracked:
        """See `StereoOdometry`."""
        cv2.setRNGSeed(self._seed)
        features = self._finder.find(left, right)
        expected = self._pose @ self._motion
        tied = self._tie(features, expected)
        self.features_px, self.inliers_px = features.points, np.empty((0, 2))
        if tied is not None:
            pose, self.inliers_px = tied
            shared = len(self.inliers_px)
            self._motion = np.linalg.inv(self._pose) @ pose
            self._most_shared = max(self._most_shared, shared)
        else:
            pose, shared = expected, 0
            # Do not continue a motion that was wrong: features are now looked for where they were.
            self._motion = np.eye(4)
        first = self._before is None
        self._pose, self._before = pose, self._keep(pose, features)
        if shared < max(STALE_SHARE * self._most_shared, FEWEST_INLIERS) or tied is None:
            self._keys = [*self._keys[1 - KEYS :], self._before]
            self._most_shared = 0
        lost = len(self._before.points) < FEWEST_INLIERS if first else tied is None
        return Tracked(pose.copy(), lost)

    def _keep(self, pose: Floats, features: StereoFeatures) -> _Key:
        deep = ~np.isnan(features.right_x)
        seen = np.column_stack([features.points, features.right_x])[deep]
        points = transform(pose, triangulate(self._camera, seen))
        return _Key(features.image, seen[:, :2], points, features.descriptors[deep])

    def _tie(self, features: StereoFeatures, expected: Floats) -> tuple[Floats, Floats] | None:
        """Pose of a pair from what it shares with earlier ones, and where it sees the points of the last key pair. None
        when it shares too little or the pose is implausible."""
        if self._before is None:
            return None
        earlier = self._keys if self._before is self._keys[-1] else [self._before, *self._keys]
        found = [self._shared(key, features, expected) for key in earlier]
        points, seen, sigmas = (np.concatenate(parts) for parts in zip(*found, strict=True))
        rough = rough_pose(self._camera, points, seen[:, :2])
        if rough is None:
            return None
        to_camera, agree = refined_pose(self._camera, rough, points, seen, sigmas)
        pose = np.asarray(np.linalg.inv(to_camera), np.float64)
        if agree.sum() < FEWEST_INLIERS or self._jumps(np.linalg.inv(expected) @ pose):
            return None
        of_last = len(seen) - len(found[-1][0])
        return pose, seen[of_last:, :2][agree[of_last:]]

    def _shared(self, key: _Key, features: StereoFeatures, expected: Floats) -> tuple[Floats, Floats, Floats]:
        """Points of a key pair that this pair sees too, where (as `project` returns it), and how precisely."""
        local = transform(np.asarray(np.linalg.inv(expected), np.float64), key.points)
        where = project(self._camera, local)[:, :2]
        near = apart(features.points[:, 0], where[:, 0]) < self._reach * NEAR_PX
        near &= apart(features.points[:, 1], where[:, 1]) < self._reach * NEAR_PX
        near &= local[:, 2] > IN_FRONT_M
        here, there = match(features.descriptors, key.descriptors, near)
        by_orb = features.points[here]
        placed, good = place(key.image, features.image, key.seen[there], by_orb, (REACH_PX, REACH_PX))
        seen = np.where(good[:, None], placed, by_orb)
        # The disparity found for the feature holds in its neighbourhood.
        right_x = features.right_x[here] + seen[:, 0] - by_orb[:, 0]
        sigmas = np.where(good, PLACED_SIGMA, features.sigmas[here])
        return key.points[there], np.column_stack([seen, right_x]), sigmas

    def _jumps(self, off: Floats) -> bool:
        turn_rad, move_m = float(np.linalg.norm(cv2.Rodrigues(off[:3, :3])[0])), float(np.linalg.norm(off[:3, 3]))
        return turn_rad > self._reach * LARGEST_JUMP_RAD or move_m > self._reach * LARGEST_JUMP_M


def in_house() -> OrbOdometry:
    """Our odometry on the simulated rig."""
    return OrbOdometry(StereoCamera.simulated())
