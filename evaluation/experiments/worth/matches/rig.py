"""Two cameras before a moving view: the frames of a course for any setting."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from evaluation.experiments.worth.matches.pairs import Truth
from evaluation.experiments.worth.matches.scenes import CANVAS, DISPARITY_PX, HEIGHT, WIDTH, MovingView, Radiance
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import LIMITS
from fake_camera.imaging import PIXEL_FORMATS, ImageSettings
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side, StereoPair
from imaging.pixels import Pixels

LONGEST_S = LIMITS.max_time_us * 1e-6
# Motion of the image's middle between rendered instants: within 1 pixel where panoramas move faster, at their ends.
BLUR_STEP_PX = 0.75
DARK = 2.0**-8  # What a lens cap with a pinhole lets through: the other eye is 8 stops darker
DIRT_SIGMA_PX = 6.0  # Blur by dirt on the lens: no detail is left, only large shapes

_EYES: dict[str, Callable[[Radiance], Radiance]] = {
    "open": lambda seen: seen,
    "dark": lambda seen: seen * np.float32(DARK),
    "dirty": lambda seen: np.asarray(cv2.GaussianBlur(seen, (0, 0), DIRT_SIGMA_PX), np.float32),
    "dead": np.zeros_like,
}

DEFAULT_SENSOR = SensorModel(width=WIDTH, height=HEIGHT)
EYES = tuple(_EYES)  # States of the right camera; a dead one delivers frames without light


class Film:
    """The radiance of both cameras in exposures of any length; rendered on demand, once for everyone who exposes.

    An exposure of a moving camera is the mean over the instants that it spans, as in `evaluation.stage.rendering`.

    `view`: what is seen, per lux. `speed_px`: of the image, in its pixels per 1/60 s. `lux`: light in each frame.
    """

    def __init__(self, view: MovingView, speed_px: float, lux: Callable[[int], float]) -> None:
        self._view, self._lux = view, lux
        self._instants = max(1, math.ceil(speed_px * RATE_HZ * LONGEST_S / BLUR_STEP_PX))
        self._sums: list[Radiance] = []
        self.frame = -1

    def go_to(self, frame: int) -> None:
        """Make this the present frame."""
        if frame != self.frame:
            self.frame, self._sums = frame, []

    def radiance(self, exposure_s: float) -> Radiance:
        """Mean radiance over an exposure of the present frame, (HEIGHT, CANVAS[0])."""
        part_s = LONGEST_S / self._instants
        whole = min(int(exposure_s / part_s), self._instants - 1)
        while len(self._sums) <= whole:
            at_s = self.frame / RATE_HZ + (len(self._sums) + 0.5) * part_s
            seen = self._view.radiance(at_s) * np.float32(self._lux(self.frame))
            self._sums.append(self._sums[-1] + seen if self._sums else seen)
        share = exposure_s / part_s - whole
        if whole == 0:
            return self._sums[0]
        scale = part_s / exposure_s
        mean = cv2.addWeighted(self._sums[whole - 1], (1 - share) * scale, self._sums[whole], share * scale, 0.0)
        return np.asarray(mean, np.float32)

    def truth(self, first: tuple[int, float], second: tuple[int, float]) -> Truth:
        """The motion between two left frames (number, exposure time in us), each at the middle of its exposure."""
        middles = [number / RATE_HZ + self._middle_s(time_us * 1e-6) for number, time_us in (first, second)]
        return Truth(self._view.homography(*middles), self._view.model)

    def _middle_s(self, exposure_s: float) -> float:
        """When, after the start, the mean radiance was seen: short of a part, everything is seen at its middle."""
        return max(exposure_s, LONGEST_S / self._instants) / 2


@dataclass(frozen=True, slots=True)
class Eyes:
    """What the cameras of a rig are."""

    model: SensorModel = DEFAULT_SENSOR  # the sensor; its size is that of the view
    response: str = "linear"  # name of its response function
    pixel_format: str = "Mono8"  # "Mono8" or "Mono12"
    right: str = "open"  # state of the right camera, one of `EYES`


class Rig:
    """Exposes the frames of a film; the noise of a frame is the same whatever its exposure.

    `film`: what is seen. `eyes`: with what. `seed`: of the noise.
    """

    def __init__(self, film: Film, eyes: Eyes, seed: int) -> None:
        self._film, self._eyes, self._seed = film, eyes, seed
        self._sensors = {side: Sensor(eyes.model, 2 * seed + (side == "right"), eyes.response) for side in _SIDES}

    def expose(self, side: Side, setting: ExposureSetting) -> Frame:
        """The frame that one camera takes of the film's present frame."""
        seen = self._film.radiance(setting.exposure_time_us * 1e-6)
        seen = seen[:, :WIDTH] if side == "left" else _EYES[self._eyes.right](seen[:, DISPARITY_PX:])
        settings = ImageSettings(
            setting.exposure_time_us, setting.gain_db, 0.0, 1.0, self._eyes.pixel_format, 0, 0, WIDTH, HEIGHT, 1, 1
        )
        number = self._film.frame
        pixels: Pixels = self._sensors[side].expose(seen, settings, self._seed * 100_000 + number)
        time_ns = round(number / RATE_HZ * 1e9)
        depth = PIXEL_FORMATS[self._eyes.pixel_format].bit_depth
        return Frame(pixels, depth, number, time_ns, time_ns, time_ns, setting)

    def take(self, setting: ExposureSetting) -> StereoPair:
        """The pair that both cameras take with one setting."""
        return StereoPair(self._film.frame, {side: self.expose(side, setting) for side in _SIDES})


_SIDES: tuple[Side, Side] = ("left", "right")
assert CANVAS == (WIDTH + DISPARITY_PX, HEIGHT)
