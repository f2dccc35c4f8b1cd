"""What a camera does between its start and its first frame: compile, time its frames, and answer searches."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from fake_camera.device.features import Features
from fake_camera.imaging import PIXEL_FORMATS, ImageSettings, ImageSource, Pixels
from fake_camera.world.sensor import SensorModel

_LONGEST_US = 7500.0  # the demo's longest exposure, where motion blur costs most
_FROM_S = 5.0  # the path begins at rest; by then the camera moves
_PERIOD_S = 1 / 60
_FRAMES = 8


class Unpainted:
    """An `ImageSource` until the real one is built: a camera with it can be found, and its images are black."""

    def __init__(self) -> None:
        model = SensorModel()
        self.sensor_width, self.sensor_height = model.width, model.height

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        """A black image."""
        return np.zeros((settings.height, settings.width), PIXEL_FORMATS[settings.pixel_format].dtype)

    def lux(self, time_s: float) -> float:
        """No light."""
        return 0.0


def warm_up(source: ImageSource) -> None:
    """Render once in each pixel format, so that compilation and cold caches do not delay the first frames."""
    settings = _settings(source)
    for pixel_format in PIXEL_FORMATS:
        source.take(0.0, dataclasses.replace(settings, pixel_format=pixel_format), 0)
    source.lux(0.0)


def frame_s(source: ImageSource, clock_s: Callable[[], float] = time.process_time) -> float:
    """Processor time in seconds for one frame of a long exposure in motion; the first is not counted."""
    settings = dataclasses.replace(_settings(source), exposure_time_us=_LONGEST_US)
    source.take(_FROM_S, settings, 0)
    begun_s = clock_s()
    for number in range(1, _FRAMES + 1):
        source.take(_FROM_S + number * _PERIOD_S, settings, number)
    return (clock_s() - begun_s) / _FRAMES


def _settings(source: ImageSource) -> ImageSettings:
    """Those of a camera after power-on."""
    return Features("", source.sensor_width, source.sensor_height, lambda: 0).image_settings(0)
