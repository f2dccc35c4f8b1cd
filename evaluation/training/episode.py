"""One camera through one random course, for training: far coarser and faster than the arena's stage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.learned.policies import LearnedPolicy, Sight
from autoexpose_daemon.control.policy import Look
from evaluation.arrays import Floats, Floats32, Greys
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.scenes.stills import painting
from evaluation.scenes.views import STILL_SIZE, build_views
from imaging.exposure import ExposureLimits, ExposureSetting, linear_gain
from imaging.python310 import exp2
from imaging.response import ResponseFunction

DIMMEST, BRIGHTEST = -1.0, 13.0  # log2 of lux: half a lux, and 8000
STEP_CHANCE = 1.0 / 40.0  # Of a step in a frame, where light steps
LARGEST_STEP_STOPS = 8.0
FLICKER_HZ = 100.0
FASTEST_PX = 20.0  # Of a view, in pixels that control sees, from frame to frame


def random_light(rng: np.random.Generator, frames: int) -> Floats:
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


PAINTERS = ("leaves", "street")  # `room` is the third of `TUNE_SCENES` (evaluation.arena.plan)
SEEDS = range(20, 32)  # Below 100, as all that may be tuned on; none is a room of fig12 or a painting of `worth`
HEADINGS = 6  # Views of each room
OPENING_STOPS = (3.0, 8.0)  # How much brighter than the rest a window in every other painting is


@dataclass(frozen=True, slots=True, eq=False)
class TrainingPicture:
    """Radiance per lux."""

    light: Floats32  # float32, (rows, columns); one pixel is one of those that control sees
    stride: int  # every which pixel of it a simulated view takes, so that a view fits into it with room to move


def tuning_pictures(count: int) -> list[TrainingPicture]:
    """Pictures of the first so many seeds of `SEEDS`: of each a painting by every painter, and a room's views."""
    pictures: list[TrainingPicture] = []
    for seed in SEEDS[:count]:
        pictures += [TrainingPicture(_painted(painter, seed), 4) for painter in PAINTERS]
        pictures += [TrainingPicture(view, 3) for view in _room(seed)]
    return pictures


def _painted(painter: str, seed: int) -> Floats32:
    width, height = STILL_SIZE
    whole, size = painting(painter, seed, *STILL_SIZE), (width // 2, height // 2)
    light = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
    rng = np.random.default_rng([seed, 80])
    if seed % 2:
        rows, columns = (int(rng.uniform(0.3, 0.7) * 350) for _ in range(2))
        top, left = int(rng.integers(350 - rows)), int(rng.integers(width // 2 - columns))
        light[top : top + rows, left : left + columns] *= np.float32(2.0 ** rng.uniform(*OPENING_STOPS))
    return light


def _room(seed: int) -> list[Floats32]:
    """Views all around from one place, at the size that control sees."""
    view = build_views("room", seed, lambda time_s: time_s, at_window=False)["left"]
    angles = np.linspace(0.0, 2 * math.pi, HEADINGS, endpoint=False)
    views = [view.radiance(np.array([angle]), 1.0) for angle in angles]
    return [np.asarray(cv2.resize(each, (360, 270), interpolation=cv2.INTER_AREA), np.float32) for each in views]


# Pixels of a view: sampled from those that control sees, so that they differ as much from each other.
ROWS, COLUMNS = 64, 88
ELECTRONS_PER_LUX_S = 73000.0  # As the default lens of the fake cameras (fake_camera.world.sensor)
WELLS_E = (22000.0, 10500.0, 5500.0)
READ_NOISE_E = (2.0, 8.0)
AVERAGED = 6.0  # What the mean of four pixels and the median leave of the variance of noise, as a divisor
NOISE_POOL = np.random.default_rng(17).standard_normal(1 << 18).astype(np.float32)
TABLE = 1 << 14
LOWEST, HIGHEST = 2.0, 24.0  # Levels (stops) between which an answer is looked for


class Episode:
    """A view of a picture under changing light, by a camera with random response, noise, limits and delay. Motion blur
    is not simulated. `delay_frames`: from a decision to the frame that shows it."""

    def __init__(self, pictures: Sequence[TrainingPicture], rng: np.random.Generator, frames: int) -> None:
        self._rng = rng
        self.frames = frames
        self.picture = pictures[int(rng.integers(len(pictures)))]
        self.lux = random_light(rng, frames)
        rows, columns = self.picture.light.shape
        stride = self.picture.stride
        self.top = int(rng.integers(rows - ROWS * stride + 1))
        self.left = random_path(rng, frames, columns - COLUMNS * stride)
        self.delay_frames = int(rng.integers(1, 4))
        longest_us = 7500.0 if rng.random() < 0.6 else 3000.0 * 10.0 ** float(rng.random())
        self.limits = ExposureLimits(20.0, longest_us, 0.0, float(rng.uniform(12.0, 36.0)))
        self.well_e = float(rng.choice(WELLS_E))
        self.read_noise_e = float(rng.uniform(*READ_NOISE_E))
        black = 0 if rng.random() < 0.5 else int(rng.integers(1, 17))
        curve = _response_curve(rng)
        self._table = np.rint(black + (255.0 - black) * curve).astype(np.uint8)
        self._response = _known(curve, black)

    @property
    def start(self) -> ExposureSetting:
        """A random setting."""
        darkest, brightest = self.limits.darkest.level, self.limits.brightest.level
        return self.setting(float(self._rng.uniform(darkest, brightest)))

    def setting(self, level: float) -> ExposureSetting:
        """An exposure level (stops) within the limits, time before gain."""
        level = self.limits.clamp_level(level)
        return self.limits.realise(level, exp2(level))

    def look(self, frame: int, setting: ExposureSetting) -> Look:
        """What control sees of a frame taken with a setting."""
        return Look("left", self.expose(self._view(frame), setting, frame), self._response)

    def expose(self, radiance: Floats32, setting: ExposureSetting, frame: int) -> Greys:
        """An image of some radiance per lux in the light of a frame, with new noise; uint8 of its shape."""
        per_lux = ELECTRONS_PER_LUX_S * setting.exposure_time_us * 1e-6
        electrons = radiance * np.float32(self.lux[frame] * per_lux)
        start = int(self._rng.integers(NOISE_POOL.size - radiance.size))
        deviates = NOISE_POOL[start : start + radiance.size].reshape(radiance.shape)
        noise = np.sqrt((electrons + np.float32(self.read_noise_e**2)) / np.float32(AVERAGED))
        charge = np.minimum(electrons + noise * deviates, np.float32(self.well_e))
        return self._greys(charge * np.float32(linear_gain(setting.gain_db) / self.well_e))

    def level_of_mean(self, frame: int, mean: float) -> float:
        """The level (stops), within the limits, at which a frame without noise has a mean signal (0..1)."""
        light = self._view(frame) * np.float32(self.lux[frame] * ELECTRONS_PER_LUX_S * 1e-6 / self.well_e)
        black, full = self._response.black_level, 255.0
        low, high = LOWEST, HIGHEST
        for _ in range(11):
            middle = (low + high) / 2
            found = (float(self._greys(light * np.float32(exp2(middle))).mean()) - black) / (full - black)
            low, high = (middle, high) if found < mean else (low, middle)
        return self.limits.clamp_level((low + high) / 2)

    def _greys(self, signal: Floats32) -> Greys:
        places = np.clip(signal, 0.0, 1.0) * np.float32(TABLE - 1) + np.float32(0.5)
        return self._table[places.astype(np.int32)]

    def _view(self, frame: int) -> Floats32:
        stride, left = self.picture.stride, int(self.left[frame])
        return self.picture.light[self.top : self.top + ROWS * stride : stride, left : left + COLUMNS * stride : stride]

    @cached_property
    def whole_size(self) -> tuple[int, int]:
        """Rows and columns of a view with every pixel that control sees."""
        return ROWS * self.picture.stride, COLUMNS * self.picture.stride


def _response_curve(rng: np.random.Generator) -> Floats:
    """A random response: linear, a power law, or that under a film-like curve; 0..1 by signal, shape (TABLE,)."""
    signal = np.linspace(0.0, 1.0, TABLE)
    if rng.random() < 0.5:
        signal = signal ** float(rng.uniform(0.4, 1.0))
        if rng.random() < 0.5:
            share = float(rng.uniform(0.0, 0.7))
            signal = (1.0 - share) * signal + share * signal * signal * (3.0 - 2.0 * signal)
    return signal


def _known(curve: Floats, black: int) -> ResponseFunction:
    """The response as a calibration without errors finds it; black stands for half a grey level of light."""
    greys = np.maximum(np.arange(256.0) - black, 0.5) / (255.0 - black)
    light = np.interp(greys, curve, np.linspace(0.0, 1.0, TABLE))
    return ResponseFunction(np.log2(light / light[-1]), black, 255)


FAR_STOPS = 7.0  # Furthest from the right level
NEW_CHANCE = 0.25  # Of another distance in a frame; otherwise it shrinks by half, stays, or wanders a little


def babbled_levels(right: Sequence[float], rng: np.random.Generator) -> list[float]:
    """A level for each frame (stops), given the right ones: held, near, far, and coming nearer, at random."""
    apart, level, levels = float(rng.uniform(-FAR_STOPS, FAR_STOPS)), right[0], []
    for wanted in right:
        chance = float(rng.random())
        if chance < NEW_CHANCE:
            apart = float(rng.uniform(-FAR_STOPS, FAR_STOPS)) * float(rng.random())
            level = wanted + apart
        elif chance < 0.5:
            apart /= 2
            level = wanted + apart
        elif chance < 0.6:
            level += float(rng.normal(0.0, 0.3))
        levels.append(level)
    return levels


def sights_of(policy: type[LearnedPolicy], episode: Episode, settings: Sequence[ExposureSetting]) -> list[Sight]:
    """What a policy remembers of each frame of an episode, taken with these settings."""
    return [
        Sight("left", setting.level, policy.features(episode.look(frame, setting)))
        for frame, setting in enumerate(settings)
    ]
