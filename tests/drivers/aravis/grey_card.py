"""A scene that shows what each frame was really taken with."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from drivers.aravis import AravisCamera
from fake_camera.imaging import ImageSettings
from imaging.exposure import ExposureSetting, linear_gain
from imaging.frames import Frame

US_PER_GREY = 40.0
PATIENCE_S = 20.0


class GreyCard:
    """A uniform grey proportional to exposure: frames show what they were actually taken with."""

    sensor_width, sensor_height = 64, 48

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> NDArray[np.uint8]:
        grey = (settings.exposure_time_us / US_PER_GREY * linear_gain(settings.gain_db) / 255) ** settings.gamma * 255
        return np.full((settings.height, settings.width), min(round(grey), 255), np.uint8)

    def lux(self, time_s: float) -> float:
        return 1.0


def frames_until(camera: AravisCamera, grey: float) -> list[Frame]:
    """Frames up to three of this grey level in a row."""
    frames: list[Frame] = []
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        frame = camera.next_frame(0.2)
        if isinstance(frame, Frame):
            frames.append(frame)
            if len(frames) >= 3 and all(abs(late.pixels.mean() - grey) <= 1.5 for late in frames[-3:]):
                return frames
    raise AssertionError(f"no frames of grey level {grey:g}, but {[frame.pixels.mean() for frame in frames]}")


def grey_of(setting: ExposureSetting) -> float:
    return setting.exposure_time_us / US_PER_GREY * linear_gain(setting.gain_db)
