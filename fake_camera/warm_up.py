"""What a camera does between its start and its first frame: compile, time its frames, and answer searches."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from fake_camera.device.features import Features
from fake_camera.imaging import PIXEL_FORMATS, ImageSettings, ImageSource, Pixels

_LONGEST_US = 7500.0  # the demo's longest exposure, where motion blur costs most
_FROM_S = 5.0  # the path begins at rest; by then the camera moves
_PERIOD_S = 1 / 60
_FRAMES = 8


class Unpainted:
    """An `ImageSource` until the real one is built: a camera with it can be found, and its images are black."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.sensor_width, self.sensor_height = size

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        """A black image."""
        pixel_format = PIXEL_FORMATS[settings.pixel_format]
        return np.zeros(pixel_format.shape(settings.width, settings.height), pixel_format.dtype)

    def lux(self, time_s: float) -> float:
        """No light."""
        return 0.0


def warm_up(source: ImageSource, pixel_format: str) -> None:
    """Render once in each type of pixels, so that compilation and cold caches do not delay the first frames."""
    for each in ("Mono8", "Mono12", pixel_format):
        source.take(0.0, _settings(source, each), 0)
    source.lux(0.0)


def frame_s(source: ImageSource, pixel_format: str, clock_s: Callable[[], float] = time.process_time) -> float:
    """Processor time in seconds for one frame of a long exposure in motion; the first is not counted."""
    settings = dataclasses.replace(_settings(source, pixel_format), exposure_time_us=_LONGEST_US)
    source.take(_FROM_S, settings, 0)
    begun_s = clock_s()
    for number in range(1, _FRAMES + 1):
        pixels = source.take(_FROM_S + number * _PERIOD_S, settings, number)
        PIXEL_FORMATS[pixel_format].on_the_wire(pixels)
    return (clock_s() - begun_s) / _FRAMES


def _settings(source: ImageSource, pixel_format: str) -> ImageSettings:
    """Those of a camera after power-on."""
    size = source.sensor_width, source.sensor_height
    return Features("", *size, lambda: 0, pixel_format=pixel_format).image_settings(0)
