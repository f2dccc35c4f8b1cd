"""The renderer against plain arithmetic, and motion blur from one instant against the mean over many."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core import caching
from numpy.typing import NDArray

from fake_camera.world.compiled import compiled
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.render.smear import LONGEST_PX
from fake_camera.world.scene.path import CameraPath, right_of
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.simulation import RoomView

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


MOVING = Pinhole(width=200, height=150, focal_px=240.0)
REFERENCE_INSTANTS = 64


def wall(distance_m: float = 2.0) -> Surface:
    """A wall in front of the camera, with blobs of a few pixels on it."""
    pattern = np.kron(np.random.default_rng(4).random((60, 60)), np.ones((6, 6))).astype(np.float32)
    corner = np.array([-1.5 * distance_m, -1.5 * distance_m, distance_m])
    return Surface(corner, np.array([3.0 * distance_m, 0, 0]), np.array([0, 3.0 * distance_m, 0]), pattern)


def pose(turn_rad: float = 0.0, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    return np.array([[cos, 0.0, sin, x], [0.0, 1.0, 0.0, y], [-sin, 0.0, cos, z], [0.0, 0.0, 0.0, 1.0]])


def contrast_error(image: NDArray[np.float32], reference: NDArray[np.float32]) -> float:
    """Root mean square of the difference, as a part of the reference's own contrast."""
    return float(np.sqrt(np.mean((image - reference) ** 2)) / np.std(reference))


@pytest.mark.parametrize(
    "motion",
    [
        pytest.param({"turn_rad": 0.05}, id="turn"),
        pytest.param({"x": 0.12}, id="sideways"),
        pytest.param({"y": 0.1}, id="up"),
        pytest.param({"x": 0.08, "y": -0.06}, id="askew"),
        pytest.param({"turn_rad": -0.03, "z": 0.1}, id="ahead in a turn"),
    ],
)
def test_any_motion_blurs_as_many_instants_do(motion: dict[str, float]) -> None:
    renderer = Renderer([wall()], MOVING)

    def at(part: float) -> NDArray[np.float64]:
        return pose(**{name: value * (part - 0.5) for name, value in motion.items()})

    instants = np.array([at((i + 0.5) / REFERENCE_INSTANTS) for i in range(REFERENCE_INSTANTS)])
    reference = renderer.render(instants, 1.0).copy()
    sharp = contrast_error(renderer.render(at(0.5)[None], 1.0), reference)
    blurred = contrast_error(renderer.render_motion(np.array([[at(0.0), at(0.5), at(1.0)]]), 1.0), reference)
    assert sharp > 0.2
    assert blurred < 0.06


def test_a_camera_at_rest_sees_what_one_instant_shows() -> None:
    renderer = Renderer([wall()], MOVING)
    expected = renderer.render(pose()[None], 40.0).copy()
    np.testing.assert_allclose(renderer.render_motion(np.array([[pose()] * 3]), 40.0), expected, rtol=1e-3)


def test_a_motion_may_be_cut_into_parts() -> None:
    renderer = Renderer([wall()], MOVING)
    times = np.linspace(-0.5, 0.5, 9)
    whole = renderer.render_motion(np.array([[pose(x=0.1 * t) for t in (-0.5, 0.0, 0.5)]]), 1.0).copy()
    parts = [[pose(x=0.1 * times[i + step]) for step in range(3)] for i in (0, 2, 4, 6)]
    assert contrast_error(renderer.render_motion(np.array(parts), 1.0), whole) < 0.04


def test_the_longest_motion_stays_in_its_margin_and_keeps_the_light() -> None:
    even = Surface(*(wall().corner, wall().edge_u, wall().edge_v), np.full((64, 64), 0.7, np.float32))
    renderer = Renderer([even], MOVING)
    for turn_rad in (LONGEST_PX / MOVING.focal_px, 3 * LONGEST_PX / MOVING.focal_px):
        ends = [pose(turn_rad * part) for part in (-0.5, 0.0, 0.5)]
        np.testing.assert_allclose(renderer.render_motion(np.array([ends]), 100.0), 70.0, rtol=1e-3)


def test_dark_pixels_beside_a_bright_lamp_keep_their_value() -> None:
    """Running sums over a row must not lose the dark in the rounding of the bright."""
    pattern = np.full((64, 64), 2e-5, np.float32)
    pattern[:, :24] = 1.0
    lit = Surface(*(wall().corner, wall().edge_u, wall().edge_v), pattern)
    renderer = Renderer([lit], MOVING)
    ends = np.array([[pose(0.03 * part) for part in (-0.5, 0.0, 0.5)]])
    dark = renderer.render_motion(ends, 1000.0)[:, 120:]
    np.testing.assert_allclose(dark, 0.02, rtol=0.25)  # of which 16-bit texels are the most
    assert np.ptp(dark) < 1e-3


@pytest.mark.parametrize("right", [False, True])
def test_the_room_is_blurred_as_by_many_instants(right: bool) -> None:
    """The longest exposures of the demo, all along the path: images err little against the mean of many instants."""
    path = CameraPath()
    renderer = Renderer(furnished_room(1), Pinhole())
    view = RoomView(renderer, path, "right" if right else "left")
    errors, sharp_errors = [], []
    for start_s in np.arange(2.0, 24.0, 2.0):
        times_s = start_s + 7.5e-3 * (np.arange(REFERENCE_INSTANTS) + 0.5) / REFERENCE_INSTANTS
        poses = [path.pose(t) for t in times_s]
        reference = renderer.render(np.array([right_of(p) if right else p for p in poses]), 40.0).copy()
        errors.append(contrast_error(view.exposed(start_s, 7.5e-3, 40.0), reference))
        sharp_errors.append(contrast_error(view.exposed(start_s + 3.75e-3, 0.0, 40.0), reference))
    assert max(errors) < 0.05
    assert np.mean(errors) < 0.03
    assert np.mean(errors) < 0.3 * np.mean(sharp_errors)


def test_functions_compile_where_nothing_can_be_cached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    @compiled(fastmath=True)
    def twice(number: int) -> int:
        return 2 * number

    assert twice(21) == 42
