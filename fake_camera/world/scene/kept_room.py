"""A painted room kept in a file, since painting takes most of a camera's start."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene import room, shapes, textures


def kept_room(seed: int, folder: Path, cleared: bool = False) -> tuple[Surface, ...]:
    """The room of `furnished_room` for a seed, from the file in `folder` if that holds it.

    An unusable folder only costs time.
    """
    file, made_by = folder / ("cleared-room.npz" if cleared else "room.npz"), _made_by(seed)
    surfaces = _load(file, made_by)
    if surfaces is None:
        surfaces = room.furnished_room(seed, cleared)
        _save(file, made_by, surfaces)
    return surfaces


def _made_by(seed: int) -> str:
    """Everything that determines what a room looks like."""
    sources = b"".join(Path(str(module.__file__)).read_bytes() for module in (room, shapes, textures))
    return f"{seed} {np.__version__} {cv2.__version__} {hashlib.sha256(sources).hexdigest()}"


def _load(file: Path, made_by: str) -> tuple[Surface, ...] | None:
    try:
        with file.open("rb") as content, np.load(content) as kept:
            if str(kept["made_by"]) != made_by:
                return None
            rectangles, follows_light = kept["rectangles"], kept["follows_light"]
            return tuple(
                Surface(corner, edge_u, edge_v, kept[f"pattern{index}"], bool(follows_light[index]))
                for index, (corner, edge_u, edge_v) in enumerate(rectangles)
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _save(file: Path, made_by: str, surfaces: tuple[Surface, ...]) -> None:
    """Write the file atomically, since two cameras may do so at the same time."""
    content: dict[str, Any] = {f"pattern{index}": surface.pattern for index, surface in enumerate(surfaces)}
    content["rectangles"] = [[surface.corner, surface.edge_u, surface.edge_v] for surface in surfaces]
    content["follows_light"] = [surface.follows_light for surface in surfaces]
    content["made_by"] = made_by
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(dir=file.parent, suffix=".npz")
    except OSError:
        return
    try:
        with os.fdopen(descriptor, "wb") as part:
            np.savez(part, **content)
        Path(name).replace(file)
    except OSError:
        Path(name).unlink(missing_ok=True)
