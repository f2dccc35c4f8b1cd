"""How fast the image moves: by tiles, or by rough optical flow (Begin & Hunter 2022, algorithm 1, lines 1 to 6)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics import extension as _native
from autoexpose_daemon.control.picture.image import FLOW_SIZE, fit
from autoexpose_daemon.control.snapshot import Built, Stateful
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction, prediction_table

REFERENCE_INTERVAL_NS = 1e9 / 60
"""Speeds are per 1/60 s: the paper's tuning (k_offset, w) belongs to displacements per frame of its 60 Hz camera."""

PER_US = 60e-6
"""Reference intervals in a microsecond."""

_LEAST_SIDE = 16
"""Blocks: four at the size that tiles start from."""

BLACK = 1.5
"""Grey levels above the black level: the log of less is mostly noise."""

_STEPS, _MOST_LIGHT = 128.0, 2047.0
"""Steps in a stop of the log of light, and the most of them (16 stops) that fit the integers of the C extension."""

LONGEST_INTERVAL_NS = 250e6
"""Frames further apart (a quarter of a second, 15 frames of the paper's camera) no longer show the same things."""


class Motion(Stateful, ABC):
    """Speed of image points between successive frames, by what a subclass does with them."""

    _shape: tuple[int, ...]
    _allocated_for: Built[tuple[int, ...]]
    _previous_time_ns: int | None = None

    def __init__(self) -> None:
        self._shape = self._allocated_for = (0, 0)

    @abstractmethod
    def _allocate(self, shape: tuple[int, ...]) -> None:
        """Make what images of a shape need."""

    @abstractmethod
    def _moved_share(self, image: NDArray[np.uint8], level: float, *, compare: bool) -> float | None:
        """Take in an image; `compare`: and say by what share of its width it has moved since the one before.

        None if they do not tell.
        """

    def measure(self, image: NDArray[np.uint8], full_width: int, level: float, device_time_ns: int) -> float | None:
        """Their speed in pixels of full resolution per 1/60 s; None for a frame without a usable predecessor.

        `image` is the prepared one, uint8, (height, width), of a frame `full_width` pixels wide, taken at an exposure
        level (stops) and a time on its camera's clock. Raises ConfigurationError for frames that are too narrow.
        """
        if image.shape != self._shape:
            self._shape, self._previous_time_ns = image.shape, None
        if image.shape != self._allocated_for:
            self._allocate(image.shape)
            self._allocated_for = image.shape
        interval_ns = 0 if self._previous_time_ns is None else device_time_ns - self._previous_time_ns
        self._previous_time_ns = device_time_ns
        share = self._moved_share(image, level, compare=0 < interval_ns <= LONGEST_INTERVAL_NS)
        return None if share is None else share * full_width * REFERENCE_INTERVAL_NS / interval_ns

    def forget(self) -> None:
        """Treat the next frame as one without a predecessor."""
        self._previous_time_ns = None


class TileMotion(Motion):
    """Median motion of the log of light in twelve tiles of the picture, of blocks of pixels.

    The picture as a whole is searched for at a quarter of the size; from there each tile takes Gauss-Newton steps. All
    of it goes by differences of light within a picture, as far as both pictures can show them: neither exposure nor
    light that changes looks like motion, and `level` does not matter.
    """

    _previous: NDArray[np.int16]
    _side: Built[int]
    _light_of_sum: Built[NDArray[np.int16]]

    def __init__(self, response: ResponseFunction) -> None:
        super().__init__()
        self._response = response
        self._previous = np.empty((0, 0), np.int16)

    def _allocate(self, shape: tuple[int, ...]) -> None:
        height, width = shape
        side = self._side = math.ceil(max(width / FLOW_SIZE[0], height / FLOW_SIZE[1]))
        if min(height // side, width // side) < _LEAST_SIDE:
            raise ConfigurationError(
                f"frames shrunk to {width // side}x{height // side} pixels are too narrow to measure motion: at least "
                f"{_LEAST_SIDE} pixels either way are needed; use Farneback flow or a squarer region of the sensor"
            )
        greys = np.arange(side * side * 255 + 1) / (side * side)
        black, white = self._response.inverse_between(np.array([self._response.black_level + BLACK, 255.0]))
        black = max(black, white - _MOST_LIGHT / _STEPS)
        light = self._response.inverse_between(greys).clip(black, white) - black
        self._light_of_sum = np.rint(_STEPS * light).astype(np.int16)

    def _moved_share(self, image: NDArray[np.uint8], level: float, *, compare: bool) -> float | None:
        height, width = image.shape
        now = np.empty((height // self._side, width // self._side), np.int16)
        moved_px = _native.median_shift(image, self._side, self._light_of_sum, self._previous if compare else None, now)
        self._previous = now
        return None if moved_px is None else moved_px / width


class FarnebackMotion(Motion):
    """Motion by Farneback's flow with the paper's parameters.

    For 720x540 frames shifted by up to 40 pixels the speed is within 5 %; it saturates near 45 to 50 and falls beyond.
    In the dark it is too low: at a mean of 4 grey levels an eighth to a third.

    The previous frame is first brought to the exposure of this one through the response function, since flow mistakes a
    change of brightness for motion.
    """

    _previous: NDArray[np.uint8]
    _previous_level: float = 0.0
    _half: Built[NDArray[np.uint8]]
    _current: Built[NDArray[np.uint8]]
    _previous_here: Built[NDArray[np.uint8]]
    _flow: Built[NDArray[np.float32]]
    _squares: Built[NDArray[np.float32]]
    _length: Built[NDArray[np.float32]]

    def __init__(self, response: ResponseFunction) -> None:
        super().__init__()
        self._response = response
        self._previous = np.empty((0, 0), np.uint8)

    def _allocate(self, shape: tuple[int, ...]) -> None:
        width, height = fit(shape, FLOW_SIZE)
        half_width, half_height = max(width, shape[1] // 2), max(height, shape[0] // 2)
        self._half = np.empty((half_height, half_width), np.uint8)
        self._current = np.empty((height, width), np.uint8)
        self._previous_here = np.empty((height, width), np.uint8)
        self._flow = np.empty((height, width, 2), np.float32)
        self._squares = np.empty_like(self._flow)
        self._length = np.empty((height, width), np.float32)

    def _moved_share(self, image: NDArray[np.uint8], level: float, *, compare: bool) -> float | None:
        self._shrink(image)
        share = self._mean_displacement(level) / self._current.shape[1] if compare else None
        self._previous, self._previous_level = self._current.copy(), level
        return share

    def _shrink(self, image: NDArray[np.uint8]) -> None:
        """Halve by area, then interpolate: close to an area average at a ratio like 3.97, for a sixth of its cost."""
        width, height = self._current.shape[1], self._current.shape[0]
        half_width, half_height = self._half.shape[1], self._half.shape[0]
        cv2.resize(image, (half_width, half_height), dst=self._half, interpolation=cv2.INTER_AREA)
        cv2.resize(self._half, (width, height), dst=self._current, interpolation=cv2.INTER_LINEAR)

    def _mean_displacement(self, level: float) -> float:
        """Mean length of the flow (pixels of the small image) from the previous image to this one."""
        previous = self._previous
        if level != self._previous_level:
            table = prediction_table(self._response, level - self._previous_level)
            cv2.LUT(previous, table, dst=self._previous_here)
            previous = self._previous_here
        # Pyramid 0.5, 1 level, window 5, 3 iterations, neighbourhood 5, sigma 1.1.
        cv2.calcOpticalFlowFarneback(previous, self._current, self._flow, 0.5, 1, 5, 3, 5, 1.1, 0)
        # Not cv2.magnitude and cv2.mean: their last bit depends on where in memory the data are, and replays are exact.
        np.multiply(self._flow, self._flow, out=self._squares)
        np.sqrt(np.add(self._squares[..., 0], self._squares[..., 1], out=self._length), out=self._length)
        return float(np.add.reduce(self._length, axis=None) / self._length.size)  # as `mean`, quicker


def blur_length_px(motion_px: float, exposure_time_us: float, scale: float) -> float:
    """Length of the motion blur, in pixels of the shrunk image, each `scale` pixels of the frame long.

    `motion_px` is the speed of image points, pixels of full resolution per 1/60 s.
    """
    return motion_px * PER_US * exposure_time_us / scale
