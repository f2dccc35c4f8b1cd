"""The frames of both cameras along a course, for any exposure: what all runs of a course share."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from evaluation.arrays import Floats
from evaluation.scenes.scenarios import RATE_HZ, Course
from evaluation.scenes.views import Scene
from evaluation.stage.camera import LIMITS, Image, Radiance, SimulatedCamera, pair_of
from fake_camera.world.lighting import LightScript
from fake_camera.world.sensor import DEFAULT_F_NUMBER
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, FrameSet

BOTH: tuple[CameraName, CameraName] = ("left", "right")
LAMP_RADIANCE = 2500.0  # In lux times reflectance: 8 to 10 stops above a wall in the light of `lamp_right`
# An exposure of a moving camera is rendered as one instant for every 1.5 pixels that the image moves.
BLUR_STEP_PX = 1.5


class Stage:
    """Exposes frames of one course; the noise of a frame is the same whatever its exposure.

    The radiance before a still camera is affine in the light, so it is rendered twice and combined. Before a moving
    camera it is rendered at instants spread over the longest exposure, one for every `BLUR_STEP_PX` of motion, each in
    the light of that instant; an exposure is the mean over the instants it spans. Both are rendered on demand, once
    for all runs and oracles.

    `start_times_s`: when exposures start; None for every 1/60 s from 0. `response`, `gamma`: name of the sensors'
    response function, and the cameras' Gamma node, a power law on top of it."""

    def __init__(
        self,
        views: dict[CameraName, Scene],
        course: Course,
        seed: int,
        start_times_s: Floats | None = None,
        *,
        response: str = "linear",
        gamma: float = 1.0,
        lens_f_number: float = DEFAULT_F_NUMBER,
    ) -> None:
        self._start_times_s = start_times_s
        self._cameras = {
            camera: SimulatedCamera(2 * seed + (camera == "right"), seed, response, gamma, lens_f_number)
            for camera in views
        }
        self._films = {
            camera: _Film(view, course.light, course.lamp if camera == "right" else None)
            for camera, view in views.items()
        }
        self.views = views
        self.light = course.light
        self._lamp = course.lamp
        self.frame = 0
        self.go_to(0)

    @property
    def has_lamp(self) -> bool:
        """Whether the right camera sees a lamp that the left one does not."""
        return self._lamp is not None

    def start_s(self, frame: int) -> float:
        """When the exposure of a frame starts."""
        return frame / RATE_HZ if self._start_times_s is None else float(self._start_times_s[frame])

    def go_to(self, frame: int) -> None:
        """Make this the present frame."""
        self.frame = frame
        for film in self._films.values():
            film.go_to(self.start_s(frame))

    def glimpse_lux(self, frame: int) -> list[float]:
        """Light during the first millisecond of a frame, and that of the lamp if there is one."""
        lights = [self.light, *([self._lamp] if self._lamp else [])]
        return [light.mean_lux(self.start_s(frame), 1e-3) for light in lights]

    def radiance(self, camera: CameraName, exposure_s: float) -> Radiance:
        """Mean radiance over an exposure of this frame, float32, (height, width); overwritten by the next call."""
        return self._films[camera].radiance(exposure_s)

    def expose(self, camera: CameraName, setting: ExposureSetting) -> Image:
        """The image that one camera takes of the present frame, uint8, (540, 720)."""
        return self._cameras[camera].expose(self.radiance(camera, setting.exposure_time_us * 1e-6), setting, self.frame)

    def take(self, setting: ExposureSetting, cameras: Sequence[CameraName] = BOTH) -> FrameSet:
        """The pair that the cameras take of the present frame with one setting; of one side only, a lone frame."""
        images = {camera: self.expose(camera, setting) for camera in cameras}
        return pair_of(images, setting, self.frame, self.start_s(self.frame))


class _Film:
    """The radiance that one camera sees in exposures of any length that start together."""

    def __init__(self, view: Scene, light: LightScript, lamp: LightScript | None) -> None:
        self._view, self._light, self._lamp = view, light, lamp
        self._longest_s = LIMITS.max_time_us * 1e-6
        self._start_s = 0.0
        self._still: tuple[Radiance, Radiance] | None = None
        self._lamp_radiance = lamp_radiance(*_shape(view)) if lamp else None
        self._integrals: list[Radiance] = []
        self._instants = 1
        self._radiance = np.empty(_shape(view), np.float32)

    def go_to(self, start_s: float) -> None:
        moved_px = self._view.image_shift_px(self._start_s, start_s)
        shift_px = self._view.image_shift_px(start_s, start_s + self._longest_s)
        self._start_s = start_s
        self._instants = max(1, math.ceil(shift_px / BLUR_STEP_PX))
        self._integrals = []
        if shift_px > 0 or moved_px > 0:
            self._still = None
        self._moves = shift_px > 0

    def radiance(self, exposure_s: float) -> Radiance:
        """Mean radiance over an exposure, float32, (height, width); overwritten by the next call."""
        if self._moves:
            self._blurred(exposure_s)
        else:
            dark, per_lux = self._at_rest()
            lux = self._light.mean_lux(self._start_s, exposure_s)
            cv2.addWeighted(per_lux, lux, dark, 1.0, 0.0, dst=self._radiance)
        if self._lamp is not None and self._lamp_radiance is not None:
            lit = self._lamp.mean_lux(self._start_s, exposure_s)
            if lit > 0:
                cv2.scaleAdd(self._lamp_radiance, lit, self._radiance, dst=self._radiance)
        return self._radiance

    def _at_rest(self) -> tuple[Radiance, Radiance]:
        if self._still is None:
            now = np.array([self._start_s])
            dark = self._view.radiance(now, 0.0).copy()
            self._still = dark, self._view.radiance(now, 1.0) - dark
        return self._still

    def _blurred(self, exposure_s: float) -> None:
        part_s = self._longest_s / self._instants
        whole = min(int(exposure_s / part_s), self._instants - 1)
        share = exposure_s / part_s - whole
        while len(self._integrals) <= whole:
            self._render_next(part_s)
        scale = part_s / exposure_s
        after = self._integrals[whole]
        before = self._integrals[whole - 1] if whole else after
        cv2.addWeighted(before, (1 - share) * scale if whole else 0.0, after, share * scale, 0.0, dst=self._radiance)

    def _render_next(self, part_s: float) -> None:
        """Append the sum of the radiance of all instants up to the next one."""
        begin_s = self._start_s + len(self._integrals) * part_s
        lux = self._light.mean_lux(begin_s, part_s)
        radiance = self._view.radiance(np.array([begin_s + part_s / 2]), lux)
        self._integrals.append(self._integrals[-1] + radiance if self._integrals else radiance.copy())


def _shape(view: Scene) -> tuple[int, int]:
    height, width = view.radiance(np.array([0.0]), 1.0).shape
    return height, width


def lamp_radiance(height: int, width: int) -> Radiance:
    """A frosted bulb that fills a twentieth of the image, and the veil of its light in the lens."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    distance = np.hypot(x - 0.62 * width, y - 0.4 * height) / height
    bulb = np.clip((0.145 - distance) * 40.0, 0.0, 1.0)
    veil = 0.012 / (1.0 + (distance / 0.4) ** 2)
    return np.asarray(LAMP_RADIANCE * (bulb + veil), np.float32)
