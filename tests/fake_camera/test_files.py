"""Files that the user names, and what may stand in their place."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from fake_camera.__main__ import _description
from fake_camera.files import read_regular
from fake_camera.world.lighting import LightScript
from fake_camera.world.scene.panorama import load_radiance

READERS: tuple[Callable[[Path], object], ...] = (
    LightScript.from_file,
    load_radiance,
    lambda path: _description(path, usb3=False),
)


def test_a_regular_file_is_read_up_to_a_length(tmp_path: Path) -> None:
    path = tmp_path / "notes"
    path.write_bytes(b"x" * 4096)
    assert read_regular(path, 4096) == b"x" * 4096
    with pytest.raises(OSError, match="it is larger than 3 KiB"):
        read_regular(path, 4095)


@pytest.fixture(params=["pipe", ".", "/dev/zero", "/dev/urandom", "/dev/null"])
def odd(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "pipe":
        os.mkfifo(tmp_path / "pipe")
    return tmp_path / str(request.param)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("read", READERS)
def test_pipes_devices_and_folders_are_refused_at_once(read: Callable[[Path], object], odd: Path) -> None:
    with pytest.raises((OSError, ValueError), match="it is not a regular file") as refused:
        read(odd)
    assert str(odd) in str(refused.value)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("read", READERS)
def test_a_file_larger_than_any_is_not_read(read: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises((OSError, ValueError), match="it is larger than"):
        read(path)
