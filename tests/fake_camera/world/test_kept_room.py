"""A painted room comes back from its file as it was, or is painted again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene import kept_room as kept
from fake_camera.world.scene.kept_room import kept_room


def wall(seed: int) -> tuple[Surface, ...]:
    numbers = np.random.default_rng(seed)
    corner, edge_u, edge_v = numbers.random((3, 3))
    pattern = numbers.random((5, 7)).astype(np.float32)
    return (
        Surface(corner, edge_u, edge_v, pattern),
        Surface(corner, edge_v, edge_u, pattern[:2, :3], follows_light=False),
    )


@pytest.fixture(autouse=True)
def painted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The seeds of the rooms that were painted so far."""
    seeds: list[int] = []

    def paint(seed: int) -> tuple[Surface, ...]:
        seeds.append(seed)
        return wall(seed)

    monkeypatch.setattr(kept.room, "furnished_room", paint)
    return seeds


def assert_is(room: tuple[Surface, ...], expected: tuple[Surface, ...]) -> None:
    for one, other in zip(room, expected, strict=True):
        for name in ("corner", "edge_u", "edge_v", "pattern"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert one.pattern.dtype == np.float32
        assert one.follows_light is other.follows_light


def test_the_last_room_is_painted_once(tmp_path: Path, painted: list[int]) -> None:
    for seed in (1, 1, 2, 2, 1):
        assert_is(kept_room(seed, tmp_path / "cache"), wall(seed))
    assert painted == [1, 2, 1]
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_a_room_that_other_code_painted_is_painted_again(
    tmp_path: Path, painted: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept_room(1, tmp_path)
    monkeypatch.setattr(kept.cv2, "__version__", "0.1")
    kept_room(1, tmp_path)
    assert painted == [1, 1]


@pytest.mark.parametrize("size", [0, 10, 500])
def test_a_damaged_file_is_painted_again(tmp_path: Path, painted: list[int], size: int) -> None:
    kept_room(1, tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:size])
    assert_is(kept_room(1, tmp_path), wall(1))
    assert painted == [1, 1]


def test_without_a_place_to_keep_it_a_room_is_painted_each_time(tmp_path: Path, painted: list[int]) -> None:
    taken = tmp_path / "file"
    taken.touch()
    for _ in range(2):
        assert_is(kept_room(1, taken / "folder"), wall(1))
    assert painted == [1, 1]
