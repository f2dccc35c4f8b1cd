"""Stills: painted at random with the contrasts of places where robots work, and photographs of real radiance."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache, lru_cache
from pathlib import Path

import cv2
import numpy as np

from evaluation.arrays import Floats32
from fake_camera.world.scene.panorama import load_radiance

Still = Floats32
# (rng, width, height) -> radiance per lux, float32, (height, width), mostly around 0.2.
Painter = Callable[[np.random.Generator, int, int], Still]


def leaves(rng: np.random.Generator, width: int, height: int) -> Still:
    """Overlapping ellipses of all sizes (the dead-leaves model of natural images), gaps of sky 4 stops brighter."""
    still = np.full((height, width), 0.15, np.float32)
    for size in np.sort(6.0 * rng.pareto(1.2, 5000) + 6.0)[::-1]:
        sky = rng.random() < 0.03
        value = rng.uniform(2.0, 4.0) if sky else 0.15 * 2.0 ** rng.normal(0.0, 1.2)
        axes = (int(min(size, 160)), int(min(size * rng.uniform(0.3, 1.0), 160)))
        centre = (int(rng.integers(width)), int(rng.integers(height)))
        cv2.ellipse(still, centre, axes, float(rng.uniform(0, 180)), 0, 360, float(value), -1, cv2.LINE_AA)
    return _textured(rng, still)


def street(rng: np.random.Generator, width: int, height: int) -> Still:
    """House fronts with windows, one part in the sun and one in the shade (3 stops), bright sky over a dark road."""
    rows = np.arange(height, dtype=np.float32)[:, None]
    still = np.repeat(2.0 - 0.8 * rows / height, width, axis=1).astype(np.float32)
    horizon = int(0.62 * height)
    left = 0
    while left < width:
        span = int(rng.integers(160, 420))
        roof = int(rng.uniform(0.05, 0.45) * height)
        wall = rng.uniform(0.2, 0.6) * (1.0 if rng.random() < 0.4 else 0.125)
        still[roof:horizon, left : left + span] = wall
        pitch = int(rng.integers(36, 64))
        for top in range(roof + 12, horizon - pitch, pitch):
            for side in range(left + 10, min(left + span, width) - pitch // 2, pitch):
                still[top : top + pitch * 2 // 3, side : side + pitch // 2] = wall * rng.choice((0.15, 0.3, 1.9))
        left += span
    road = still[horizon:]
    road[:] = 0.06
    for _ in range(160):
        x, y = int(rng.integers(width)), int(rng.integers(road.shape[0]))
        cv2.rectangle(road, (x, y), (x + int(rng.integers(10, 90)), y + int(rng.integers(4, 14))), 0.3, -1)
    return _textured(rng, still)


def shelves(rng: np.random.Generator, width: int, height: int) -> Still:
    """Labelled boxes on the shelves of a store, dark in between, under fluorescent tubes 6 stops brighter."""
    still = np.full((height, width), 0.02, np.float32)
    ink = np.zeros((height, width), np.uint8)
    top = 90
    while top < height:
        left, row = 0, int(rng.integers(70, 130))
        while left < width:
            span = int(rng.integers(50, 150))
            value = 0.25 * 2.0 ** rng.normal(0.0, 0.8)
            lid = top + int(rng.integers(0, row // 3))
            still[lid : top + row, left : left + span - 6] = value
            label = str(rng.integers(100, 9999))
            cv2.putText(ink, label, (left + 6, top + row - 14), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 2)
            left += span
        top += row + 14
    still[ink > 127] *= 0.1
    for x in range(int(rng.integers(100)), width, 420):
        cv2.rectangle(still, (x, 20), (x + 240, 44), float(rng.uniform(8.0, 16.0)), -1)
    return _textured(rng, np.asarray(cv2.GaussianBlur(still, (0, 0), 0.8), np.float32))


def hall(rng: np.random.Generator, width: int, height: int) -> Still:
    """Machines in a dim workshop; windows 4 to 5 stops brighter, reflected in the floor."""
    floor, sill = int(0.7 * height), int(rng.uniform(0.25, 0.35) * height)
    still = np.full((height, width), rng.uniform(0.1, 0.2), np.float32)
    still[floor:] = 0.08
    pitch, glass = int(rng.integers(150, 320)), float(rng.uniform(3.0, 6.0))
    for left in range(int(rng.integers(pitch)), width, pitch):
        bar = max(pitch // 5, 12)
        for pane in range(left, min(left + pitch * 2 // 3, width) - bar, bar):
            still[40:sill, pane : pane + bar - 5] = glass * rng.uniform(0.6, 1.2)
            still[floor + 20 : height - 20, pane : pane + bar - 5] = glass * 0.08
    for _ in range(width // 40):
        x, tall, wide = int(rng.integers(width)), int(rng.integers(40, 260)), int(rng.integers(30, 160))
        tone = 0.12 * 2.0 ** float(rng.normal(0.0, 1.3))
        cv2.rectangle(still, (x, floor + 30 - tall), (x + wide, floor + 30), tone, -1)
        for _ in range(int(rng.integers(2, 12))):
            centre = (x + int(rng.integers(wide)), floor + 30 - int(rng.integers(tall)))
            cv2.circle(still, centre, int(rng.integers(3, 16)), tone * float(rng.choice((0.2, 2.5))), -1, cv2.LINE_AA)
    return _textured(rng, np.asarray(cv2.GaussianBlur(still, (0, 0), 0.8), np.float32))


def _textured(rng: np.random.Generator, still: Still) -> Still:
    """The grain of surfaces, fine and coarse, about a quarter of a stop."""
    fine = rng.normal(0.0, 0.2, still.shape).astype(np.float32)
    coarse = rng.normal(0.0, 0.25, (still.shape[0] // 8, still.shape[1] // 8)).astype(np.float32)
    grain = cv2.GaussianBlur(fine, (0, 0), 0.8) + cv2.resize(coarse, still.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(still * np.exp2(grain), np.float32)


PAINTERS: dict[str, Painter] = {"leaves": leaves, "street": street, "shelves": shelves, "hall": hall}


@lru_cache(maxsize=8)
def painting(painter: str, seed: int, width: int, height: int) -> Still:
    """A painting that is kept for the next who wants the same: read-only."""
    still = PAINTERS[painter](np.random.default_rng([seed, 78]), width, height)
    still.flags.writeable = False
    return still


# Where the photographs are (docs/do/experiments.md).
DATA = Path(os.environ.get("AUTOEXPOSE_DATA", Path(__file__).parents[3] / "shared" / "data"))
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
