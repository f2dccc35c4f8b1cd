"""The cameras of a recorded drive, exposed as anyone asks and turned so that rows agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, cast

import cv2
import numpy as np

from autoexpose_daemon.control.metrics.contrast import SensorNoise
from evaluation.arrays import Floats, Floats32, Greys
from evaluation.odometry.stereo import StereoCamera
from evaluation.rejudge.drive import Timeline
from imaging.exposure import ExposureSetting, linear_gain
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import CameraGeometry
from imaging.pixels import Pixels
from imaging.python310 import exp2
from imaging.response import ResponseFunction, greys_of_codes

Plane = Floats32
# Shares of full scale between which a sample loses its weight: noise lets some of the pixels near saturation clip.
FULL, CLEAR = 0.95, 0.85
# What a frame saturates is taken to be a stop brighter: so it stays saturated in one that is a little darker.
HIDDEN = 2.0
# Codes above black between which rounding stops counting in full: where noise is less than a code, all samples of one
# light are rounded alike, which no mean over them mends.
ROUNDED, FINE = 3.0, 8.0
USUAL = 0.1  # The light by which frames are weighed, as a share of full scale at the middle of their levels
# Light up to this share of full scale is exposed with its noise, which can make a sample less than full.
BRIGHTEST = 1.5
_STEPS = 4096  # Entries of the tables over light, evenly spaced in its root: noise is about the same in all of them
_POOL = 1 << 22


@dataclass(frozen=True, slots=True, eq=False)
class SeenLight:
    """What is known of the light before a camera; float32 arrays of the frame's shape."""

    # Share of full scale at exposure level 0. Where every frame was saturated, `HIDDEN` times what it is at least.
    amount: Plane
    variance: Plane  # of `amount`, from shot noise, read noise and quantisation


class Exposer:
    """One camera: its response and its sensor's noise. `seed`: of the noise that is added: the same in frames of the
    same number, whatever their setting."""

    def __init__(self, response: ResponseFunction, noise: SensorNoise, seed: int) -> None:
        self._response, self._noise, self._seed = response, noise, seed

    def light(self, frame: Frame) -> SeenLight:
        """What one frame says."""
        share, variance = self._shares(frame)
        share = np.where(share >= 1.0, HIDDEN, share)
        scale = exp2(-frame.setting.level)
        return SeenLight(_look_up(share * scale, frame.pixels), _look_up(variance * scale**2, frame.pixels))

    def fused(self, frames: Sequence[Frame]) -> SeenLight:
        """What several frames of the same thing say together. A frame counts by how well it tells a usual light,
        whatever its samples say: so noise gives no bias. Samples of few codes count less, and those near saturation not
        at all."""
        usual = USUAL * exp2(-float(np.median([frame.setting.level for frame in frames])))
        weights, amounts, variances = (np.zeros(frames[0].pixels.shape, np.float32) for _ in range(3))
        for frame in frames:
            share, variance = self._shares(frame)
            scale = exp2(-frame.setting.level)
            known = float(np.interp(usual / scale, share, variance)) * scale**2
            quantum = np.gradient(share)
            rounding = (quantum * scale) ** 2 * np.clip((FINE - share / quantum) / (FINE - ROUNDED), 0.0, 1.0)
            weight = usual**2 / (known + rounding) * np.clip((FULL - share) / (FULL - CLEAR), 0.0, 1.0)
            cv2.accumulate(_look_up(weight, frame.pixels), weights)
            cv2.accumulate(_look_up(weight * share * scale, frame.pixels), amounts)
            cv2.accumulate(_look_up(weight**2 * variance * scale**2, frame.pixels), variances)
        full = weights == 0
        weights[full] = 1.0
        amounts /= weights
        variances /= weights * weights
        amounts[full] = HIDDEN * exp2(-min(frame.setting.level for frame in frames))
        return SeenLight(amounts, variances)

    def expose(self, light: SeenLight, setting: ExposureSetting, bit_depth: int, number: int) -> Pixels:
        """The samples of a frame taken of this light, uint8, or uint16 for more bits. Noise is added up to what the
        setting has; what `light` has beyond that cannot be removed."""
        code, slope, variance = _tables(self._response, self._noise, setting.gain_db, bit_depth)
        scale = exp2(setting.level)
        share = np.clip(light.amount * np.float32(scale / BRIGHTEST), 0.0, 1.0)
        index = np.rint(np.sqrt(share) * np.float32(_STEPS - 1)).astype(np.uint16)
        known = slope[index]
        known *= known
        known *= light.variance
        known *= np.float32(scale**2)
        missing = np.sqrt(np.maximum(variance[index] - known, 0.0))
        missing *= self._normals(number, light.amount.size).reshape(light.amount.shape)
        missing += code[index]
        shift = bit_depth - 8
        full = ((self._response.saturation + 1) << shift) - 1
        rounded: Floats32 = np.rint(np.clip(missing, 0, full))
        return rounded.astype(np.uint16) if shift else rounded.astype(np.uint8)

    def _shares(self, frame: Frame) -> tuple[Floats, Floats]:
        """Share of full scale behind every code of a frame, 0..1, and its variance."""
        codes = np.arange(1 << frame.bit_depth)
        share = self._response.light(greys_of_codes(codes, frame.bit_depth))
        quantum = np.gradient(share)
        gain = linear_gain(frame.setting.gain_db)
        read = self._noise.read_noise_e * gain / self._noise.full_well_e
        return share, share * gain / self._noise.full_well_e + read**2 + quantum**2 / 12.0

    def _normals(self, number: int, size: int) -> Plane:
        start = int(np.random.default_rng([self._seed, number]).integers(_POOL))
        return _pool(size)[start : start + size]


@lru_cache(maxsize=2)
def _pool(size: int) -> Plane:
    return np.random.default_rng(0).standard_normal(_POOL + size, np.float32)


@lru_cache(maxsize=64)
def _tables(response: ResponseFunction, noise: SensorNoise, gain_db: float, bit_depth: int) -> tuple[Plane, ...]:
    """Code, its change with light, and the variance of the code, for each step of light; float32."""
    share = BRIGHTEST * np.linspace(0.0, 1.0, _STEPS) ** 2
    greys = np.arange(response.black_level, response.saturation + 1, dtype=np.float64)
    lights = response.light(greys)
    beyond = lights[-1] + (lights[-1] - lights[-2]) * np.arange(1, 1 + int(BRIGHTEST / (lights[-1] - lights[-2])))
    grey = np.interp(share, [*lights, *beyond], [*greys, *(greys[-1] + np.arange(1, 1 + len(beyond)))])
    code = _codes_of_greys(grey, bit_depth - 8)
    slope = np.gradient(code, share)
    gain = linear_gain(gain_db)
    read = noise.read_noise_e * gain / noise.full_well_e
    variance = slope**2 * (share * gain / noise.full_well_e + read**2)
    return tuple(table.astype(np.float32) for table in (code, slope, variance))


def _codes_of_greys(grey: Floats, shift: int) -> Floats:
    """The inverse of `greys_of_codes`."""
    return grey * (1 << shift) + ((1 << shift) - 1) / 2.0


def _look_up(table: Floats, codes: Pixels) -> Plane:
    entries = table.astype(np.float32)
    if codes.dtype == np.uint8:
        return cast(Plane, cv2.LUT(codes, entries))
    taken: Any = entries.take(codes, mode="clip")
    return cast(Plane, taken)


FAR_STOPS = 1.0  # A shot farther from the wanted level than this does not show what the wanted exposure would


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A pair as the cameras would have taken it."""

    pair: FrameSet  # with the wanted setting, at the time of the instant
    shot: int  # the number of the recorded pair that shows it: that of the instant if several were fused
    off_stops: float  # how far the shot's level is from the wanted one: above 0, it is darker
    # The shot's exposure time over the wanted one, at least 1: what is above is blur that cannot be removed.
    blur_ratio: float
    fused: bool  # whether it was made of several shots, of something that stands still
    time_s: float  # when what it shows was there, seconds


class RecordedCameras:
    """Makes the pairs of one instant after the other. `timeline`: the whole drive. `exposers`: of the cameras."""

    def __init__(self, timeline: Timeline, exposers: Mapping[CameraName, Exposer]) -> None:
        self.timeline = timeline
        self.exposers = exposers
        self._number = 0
        self._pair_at: Callable[[int], FrameSet] | None = None
        self._fused: dict[CameraName, SeenLight] = {}
        self._lights: dict[tuple[CameraName, int], SeenLight] = {}

    def go_to(self, number: int, pair_at: Callable[[int], FrameSet]) -> None:
        """Make this the present instant; `pair_at` gives the recorded pairs near it."""
        self._number, self._pair_at = number, pair_at
        self._fused = {}
        near = self.timeline.near(number)
        self._lights = {key: light for key, light in self._lights.items() if key[1] in near}

    def take(self, setting: ExposureSetting) -> Made:
        """The pair of the present instant, taken with a setting."""
        timeline, number = self.timeline, self._number
        present = self._recorded(number)
        still = timeline.still[number]
        shot = number if still else timeline.nearest(number, setting.level)
        shots = timeline.around(number) if still else range(shot, shot + 1)
        frames = {}
        for camera, frame in present.frames.items():
            light = self._light(camera, shots, fused=still)
            pixels = self.exposers[camera].expose(light, setting, frame.bit_depth, number)
            frames[camera] = replace(frame, pixels=pixels, setting=setting)
        levels = [timeline.glimpses[one].level for one in shots]
        nearest = min(levels, key=lambda level: abs(level - setting.level))
        blur_ratio = timeline.glimpses[shot].setting.exposure_time_us / setting.exposure_time_us
        return Made(
            FrameSet(present.trigger, frames), shot, off_stops=setting.level - nearest,
            blur_ratio=1.0 if still else max(blur_ratio, 1.0), fused=still, time_s=timeline.glimpses[shot].time_s,
        )  # fmt: skip

    def _recorded(self, number: int) -> FrameSet:
        assert self._pair_at is not None, "go to an instant first"
        return self._pair_at(number)

    def _light(self, camera: CameraName, shots: Sequence[int], *, fused: bool) -> SeenLight:
        if fused:
            if camera not in self._fused:
                self._fused[camera] = self.exposers[camera].fused(
                    [self._recorded(shot).frames[camera] for shot in shots]
                )
            return self._fused[camera]
        key = camera, shots[0]
        if key not in self._lights:
            self._lights[key] = self.exposers[camera].light(self._recorded(shots[0]).frames[camera])
        return self._lights[key]


Image = Greys


class Rectifier:
    """Both cameras of a pair, whatever their names: the right one is that with a baseline.

    `shape`: (height, width) of what `Frame.grey8` gives: half the size of a colour mosaic.
    """

    def __init__(self, geometries: Mapping[CameraName, CameraGeometry], shape: tuple[int, int]) -> None:
        self._names = sorted(geometries, key=lambda name: geometries[name].baseline_m)[:2]
        left, right = (geometries[name] for name in self._names)
        scale = shape[1] / left.width
        centre = left.projection[2], left.projection[6]
        self._maps = {camera: _maps(geometry, shape, scale, centre[0]) for camera, geometry in geometries.items()}
        x, y = ((number + 0.5) * scale - 0.5 for number in centre)
        self.camera = StereoCamera(scale * left.projection[0], (x, y), right.baseline_m)

    def images(self, pair: FrameSet) -> tuple[Image, Image]:
        """Left and right picture of a complete pair."""
        left, right = (self._rectified(camera, pair.frames[camera].grey8()) for camera in self._names)
        return left, right

    def _rectified(self, camera: CameraName, image: Image) -> Image:
        maps = self._maps[camera]
        return image if maps is None else np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)


def _maps(geometry: CameraGeometry, shape: tuple[int, int], scale: float, centre_x: float) -> tuple[Any, Any] | None:
    """What `cv2.remap` needs; None for a camera that is rectified already, with this column in the middle."""
    k = np.reshape(geometry.camera_matrix, (3, 3))
    p = np.reshape(geometry.projection, (3, 4))[:, :3]
    p[0, 2] = centre_x  # a calibration may move the columns of a pair against each other, which would look like depth
    r = np.reshape(geometry.rectification, (3, 3))
    if not any(geometry.distortion) and np.allclose(k, p) and np.allclose(r, np.eye(3)):
        return None
    to_plane = np.array([[scale, 0.0, 0.5 * scale - 0.5], [0.0, scale, 0.5 * scale - 0.5], [0.0, 0.0, 1.0]])
    k, p, size, distortion = to_plane @ k, to_plane @ p, (shape[1], shape[0]), np.array(geometry.distortion)
    if geometry.distortion_model == "equidistant":
        return cv2.fisheye.initUndistortRectifyMap(k, distortion, r, p, size, cv2.CV_32FC1)
    return cv2.initUndistortRectifyMap(k, distortion, r, p, size, cv2.CV_32FC1)
