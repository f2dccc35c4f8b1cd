"""How light and view of a training episode change: everything that the arena's scenarios do, at random."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evaluation.scenes.scenarios import RATE_HZ

DIMMEST, BRIGHTEST = -1.0, 13.0
"""log2 of lux: half a lux, and 8000."""

STEP_CHANCE = 1.0 / 40.0
"""Of a step in a frame, where light steps."""

LARGEST_STEP_STOPS = 8.0

FLICKER_HZ = 100.0

FASTEST_PX = 20.0
"""Of a view, in pixels that control sees, from frame to frame."""


def random_light(rng: np.random.Generator, frames: int) -> NDArray[np.float64]:
    """Lux in each frame, shape (frames,): steady, stepping, ramping or wandering; sometimes with flicker."""
    start = float(rng.uniform(0.0, 12.0))
    kind = int(rng.choice(4, p=(0.3, 0.35, 0.2, 0.15)))
    changes = np.zeros(frames)
    if kind == 1:
        steps = rng.random(frames) < STEP_CHANCE
        changes[steps] = rng.uniform(-LARGEST_STEP_STOPS, LARGEST_STEP_STOPS, int(steps.sum()))
    elif kind == 2:
        length = int(rng.integers(10, frames))
        begin = int(rng.integers(frames - length + 1))
        changes[begin : begin + length] = float(rng.uniform(-8.0, 8.0)) / length
    elif kind == 3:
        changes = rng.normal(0.0, 0.15, frames)
    stops = np.clip(start + np.cumsum(changes), DIMMEST, BRIGHTEST)
    lux = np.exp2(stops)
    if rng.random() < 0.15:
        phase = 2 * math.pi * (FLICKER_HZ / RATE_HZ * np.arange(frames) + float(rng.random()))
        lux *= 1.0 + float(rng.uniform(0.2, 0.95)) * np.cos(phase)
    return np.asarray(lux)


def random_path(rng: np.random.Generator, frames: int, room: int) -> NDArray[np.int_]:
    """Where a view is in each frame, whole pixels from 0 to `room`, shape (frames,); half of all stand still."""
    place = float(rng.uniform(0.0, room))
    if room == 0 or rng.random() < 0.5:
        return np.full(frames, round(place))
    amplitude = float(rng.uniform(0.1, 1.0)) * min(place, room - place)
    speed = FASTEST_PX * float(rng.uniform(0.05, 1.0))
    rate = speed / max(amplitude, 1.0)
    phase = float(rng.uniform(0.0, 2 * math.pi))
    path = place + amplitude * np.sin(rate * np.arange(frames) + phase)
    return np.asarray(np.clip(np.rint(path), 0, room), int)
