"""Rooms papered with pictures: what a surface can reflect, contrasts, and room for the cameras."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.odometry.tracking import PERIOD_S, lap
from evaluation.scenes.stills import Still
from evaluation.scenes.views import (
    BRIGHTEST,
    CARTONS,
    DARKEST,
    HIGH_STOPS,
    LENGTH_M,
    LOW_STOPS,
    TILE,
    WIDTH_M,
    Feature,
    natural_room,
)
from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.path import right_of

WALLS = slice(0, 4)


@cache
def pictures() -> tuple[Still, ...]:
    """Two with 12 and 6 stops between light and dark."""
    rng = np.random.default_rng(1)
    smooth = (cv2.GaussianBlur(rng.normal(size=(400, 420)), (0, 0), 2.0) for _ in range(2))
    return tuple(np.exp2(span * (one - one.min()) / np.ptp(one)).astype(np.float32)
                 for span, one in zip((12.0, 6.0), smooth, strict=True))  # fmt: skip


def room(seed: int = 1, feature: Feature = "plain", bearing_rad: float = 0.4) -> list[Surface]:
    return natural_room(pictures(), seed, feature, bearing_rad)


def spread(pattern: Any) -> float:
    """Stops between the 1st and the 99th percentile."""
    low, high = np.percentile(np.log2(pattern), (1.0, 99.0))
    return float(high - low)


@pytest.mark.parametrize("seed", [1, 2])
def test_two_walls_are_rich_in_contrast_and_two_poor_and_all_can_be_printed(seed: int) -> None:
    surfaces = room(seed)
    assert all(np.all((one.pattern >= DARKEST) & (one.pattern <= BRIGHTEST)) for one in surfaces)
    spans = sorted(spread(wall.pattern) for wall in surfaces[WALLS])
    assert max(spans[:2]) < 1.3 * LOW_STOPS and min(spans[2:]) > 0.8 * HIGH_STOPS
    assert {wall.pattern.shape[1] > TILE for wall in surfaces[WALLS]} == {True}


def test_the_seed_decides_the_room() -> None:
    first, again, other = room(1), room(1), room(2)
    assert all(np.array_equal(a.pattern, b.pattern) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].pattern, other[0].pattern)


def test_only_the_window_keeps_its_light_and_its_frame_is_dark() -> None:
    *others, window = room(feature="window")
    assert not window.follows_light and all(one.follows_light for one in others)
    assert len(others) == len(room())
    assert np.median(window.pattern) > 50.0 and window.pattern.min() < 1.0


def test_lamps_are_brighter_than_any_wall() -> None:
    extra = room(feature="lamps")[len(room()) :]
    assert len(extra) == 16
    assert sum(float(one.pattern.max()) > 10 * BRIGHTEST for one in extra) == 8


@given(seed=st.integers(0, 300), bearing_rad=st.floats(-3.1, 3.1), feature=st.sampled_from(["window", "lamps"]))
@settings(max_examples=4, deadline=None)
def test_all_is_inside_the_room_and_nothing_is_nearer_than_odometry_looks(
    seed: int, bearing_rad: float, feature: Feature
) -> None:
    poses = [lap(seed).pose(time_s) for time_s in np.linspace(0.0, PERIOD_S + 2.0, 80)]
    eyes = np.array([one[:2, 3] for pose in poses for one in (pose, right_of(pose))])
    surfaces = room(seed, feature, bearing_rad)
    assert len(surfaces) >= 6 + 5 * CARTONS
    for one in surfaces[6:]:
        along, down = (np.linspace(0.0, 1.0, 9)[:, None] * edge[None, :2] for edge in (one.edge_u, one.edge_v))
        places = one.corner[:2] + np.concatenate([along, along + one.edge_v[:2], down])
        assert np.all(np.abs(places) < (LENGTH_M / 2, WIDTH_M / 2))
        assert np.linalg.norm(places[:, None] - eyes[None], axis=2).min() > 0.15
