"""The renderer against plain arithmetic on simple scenes."""

from __future__ import annotations

import numpy as np
import pytest

from fake_camera.world.render.renderer import Pinhole, Renderer, Surface

CAMERA = Pinhole(width=96, height=72, focal_px=100.0)
AHEAD = np.eye(4)


def facing(distance: float, half: float, pattern: np.ndarray, x: float = 0.0, follows_light: bool = True) -> Surface:
    """A square that faces a camera at the origin of camera axes."""
    corner = np.array([x - half, -half, distance])
    edges = np.array([2 * half, 0, 0]), np.array([0, 2 * half, 0])
    return Surface(corner, *edges, pattern.astype(np.float32), follows_light)


def moved(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def test_even_wall_has_the_radiance_of_its_light() -> None:
    renderer = Renderer([facing(2.0, 5.0, np.full((64, 64), 0.4))], CAMERA)
    np.testing.assert_allclose(renderer.render(AHEAD[None], 150.0), 60.0, rtol=1e-4)


def test_gradient_lands_where_projection_says() -> None:
    ramp = np.tile((np.arange(256) + 0.5) / 256, (256, 1))
    image = Renderer([facing(2.0, 1.0, ramp)], CAMERA).render(AHEAD[None], 1.0)
    x_m = (np.arange(96) - 47.5) / CAMERA.focal_px * 2.0
    np.testing.assert_allclose(image[36], (x_m + 1.0) / 2.0, atol=3e-3)


def test_near_hides_far_and_only_the_front_is_seen() -> None:
    far = facing(2.0, 5.0, np.full((8, 8), 0.2))
    near = facing(1.0, 0.1, np.full((8, 8), 0.9))
    back = Surface(near.corner + near.edge_u, -near.edge_u, near.edge_v, near.pattern)
    image = Renderer([near, far], CAMERA).render(AHEAD[None], 1.0)
    inside = np.abs(np.arange(96) - 47.5) <= 10.0
    np.testing.assert_allclose(image[36], np.where(inside, 0.9, 0.2), rtol=1e-4)
    np.testing.assert_allclose(Renderer([back, far], CAMERA).render(AHEAD[None], 1.0), 0.2, rtol=1e-4)


def test_tiled_and_pixelwise_rendering_agree() -> None:
    """A sliver in every tile forces the pixelwise loop, which must show the same wall."""
    rng = np.random.default_rng(3)
    pattern = np.kron(rng.random((16, 16)), np.ones((8, 8)))
    wall = facing(2.0, 3.0, pattern)
    slivers = [facing(1.0, 1e-4, np.ones((8, 8)), x=(tile * 24 + 12.2 - 47.5) / 100.0) for tile in range(4)]
    for sliver in slivers:
        sliver.corner[1] = -1.0
        sliver.edge_v[1] = 2.0
    plain = Renderer([wall], CAMERA).render(AHEAD[None], 1.0).copy()
    mixed = Renderer([wall, *slivers], CAMERA).render(AHEAD[None], 1.0)
    np.testing.assert_allclose(mixed, plain, atol=1e-3)


def test_several_poses_average_and_blur_along_the_motion() -> None:
    pattern = np.zeros((256, 256))
    pattern[:, 128:] = 1.0
    renderer = Renderer([facing(2.0, 2.0, pattern)], CAMERA)
    poses = np.array([moved(x) for x in (0.0, 0.05, 0.1, 0.15)])
    singles = [renderer.render(pose[None], 1.0).copy() for pose in poses]
    blurred = renderer.render(poses, 1.0)
    np.testing.assert_allclose(blurred, np.mean(singles, axis=0), atol=1e-4)
    assert np.abs(np.diff(blurred[36])).max() < 0.5 * np.abs(np.diff(singles[0][36])).max()


def test_emitters_do_not_follow_the_light() -> None:
    scene = [facing(2.0, 5.0, np.full((8, 8), 0.5)), facing(1.0, 0.1, np.full((8, 8), 30.0), follows_light=False)]
    renderer = Renderer(scene, CAMERA)
    dark, lit = (renderer.render(AHEAD[None], lux).copy() for lux in (1.0, 101.0))
    assert dark[36, 48] == pytest.approx(30.0, rel=1e-4)
    assert lit[36, 48] == pytest.approx(30.0, rel=1e-4)
    assert (dark[5, 5], lit[5, 5]) == pytest.approx((0.5, 50.5), rel=1e-4)


def test_distant_texture_is_averaged_not_aliased() -> None:
    checks = np.indices((512, 512)).sum(axis=0) % 2
    image = Renderer([facing(8.0, 5.0, checks.astype(float))], CAMERA).render(AHEAD[None], 1.0)
    np.testing.assert_allclose(image[10:60, 10:80], 0.5, atol=0.02)
