"""The pictures that judges use: photographs by their paths below `DATA`, and paintings by `painter:seed`."""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path

from evaluation.scenes.stills import Still, painting
from fake_camera.world.scene.panorama import load_radiance

# Where the photographs are (docs/experiments.md).
DATA = Path(os.environ.get("AUTOEXPOSE_DATA", Path(__file__).parents[4] / "shared" / "data"))
PAINTED_SIZE = (1000, 640)  # Width and height of painted stills
_STILLS = {"tuning": ("Carrots", "CrissyField"), "report": ("Desk", "GoldenGate", "MtTamWest")}


def stills(name: str) -> list[str]:
    """The photographed stills of the tuning or the report set; none where there are no data."""
    return [scene for still in _STILLS[name] if (DATA / (scene := f"hdr_stills_bsd/{still}.hdr")).exists()]


@cache
def digest(scene: str) -> str:
    """SHA-256 of a photograph's file, so that results are kept only for the same picture; "" for a painting."""
    return "" if ":" in scene else hashlib.sha256((DATA / scene).read_bytes()).hexdigest()


def picture(scene: str) -> Still:
    """Its radiance per lux, (rows, columns)."""
    painter, _, seed = scene.partition(":")
    if seed:
        return painting(painter, int(seed), *PAINTED_SIZE)
    return load_radiance(DATA / scene)
