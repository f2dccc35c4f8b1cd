from __future__ import annotations

import numpy as np

from fake_camera.world.scene.path import BASELINE_M, CameraPath, right_of

STEP_S = 1 / 240


def speeds(path: CameraPath, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed in m/s and turning rate in deg/s along the path."""
    poses = np.array([path.pose(t) for t in np.arange(0, seconds, STEP_S)])
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / STEP_S
    turns = np.einsum("nji,njk->nik", poses[:-1, :3, :3], poses[1:, :3, :3])
    angles = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
    return speed, np.degrees(angles) / STEP_S


def test_speeds_stay_within_100_mm_and_100_degrees_per_second() -> None:
    speed, rate = speeds(CameraPath(), 52.0)
    assert 0.05 < speed.max() <= 0.1
    assert 40.0 < rate.max() <= 100.0


def test_starts_from_rest_and_has_no_jerks() -> None:
    speed, rate = speeds(CameraPath(), 52.0)
    assert speed[0] < 1e-4
    assert rate[0] < 0.1
    assert np.abs(np.diff(speed)).max() < 2e-3
    assert np.abs(np.diff(rate)).max() < 1.5
    np.testing.assert_array_equal(CameraPath().pose(-3.0), CameraPath().pose(0.0))


def test_is_periodic_once_at_full_speed() -> None:
    path = CameraPath()
    np.testing.assert_allclose(path.pose(5.0), path.pose(5.0 + path.period_s), atol=1e-9)


def test_poses_are_rigid_and_the_right_camera_is_80_mm_along_x() -> None:
    pose = CameraPath().pose(7.7)
    right = right_of(pose)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) > 0
    np.testing.assert_allclose(np.linalg.inv(pose) @ right[:, 3], [BASELINE_M, 0, 0, 1], atol=1e-12)
    np.testing.assert_array_equal(right[:3, :3], pose[:3, :3])
