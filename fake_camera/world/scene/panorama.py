"""Pans a camera's view across a still with real radiances."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fake_camera.files import read_regular
from fake_camera.world.colour import Tints, grey_light

_MOST_BYTES = 1 << 28

GREY = 0.18
"""The reflectance that the still's log-mean radiance is taken for: a photographer's grey card."""

ROOM_TO_PAN = 1.4
"""Minimum size of the still relative to the view, across and down; a smaller one is enlarged."""

_BLUR_STEP_PX = 1.5
"""An exposure is the mean of one instant for each 1.5 pixels of motion ..."""

_MOST_INSTANTS = 4
"""... but of at most so many: the blur of long exposures has steps."""

DISPARITY_PX = 24.0
"""Shift of the right camera's image to the left; the whole still is at one distance."""


def load_radiance(path: Path) -> NDArray[np.float32]:
    """Luminance of a Radiance .hdr file, scaled to a log-mean of `GREY`, shape (rows, columns), finite and >= 0.

    Raises ValueError when the file is missing, unreadable, not an image, or black.
    """
    try:
        content = np.frombuffer(read_regular(path, _MOST_BYTES), np.uint8)
    except OSError as error:
        raise ValueError(f"scene {path} cannot be read: {error.strerror}") from error
    if not content[:2].tobytes() == b"#?":
        raise ValueError(f"scene {path} is not a Radiance picture: give a .hdr file")
    try:
        image = cv2.imdecode(content, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise ValueError(f"scene {path} is damaged: no picture can be decoded from it")
    blue, green, red = (np.nan_to_num(image[..., i].astype(np.float32), posinf=0.0) for i in range(3))
    luminance = np.maximum(0.0722 * blue + 0.7152 * green + 0.2126 * red, np.float32(0.0))
    lit = luminance[luminance > 0]
    if lit.size == 0:
        raise ValueError(f"scene {path} is black: give a picture with light in it")
    scaled = luminance.astype(np.float64) * (GREY / math.exp(float(np.log(lit).mean(dtype=np.float64))))
    return np.asarray(np.minimum(scaled, np.finfo(np.float32).max), np.float32)


class Panorama:
    """One camera's view of a still, panned from one end to the other and back; all of it follows the light.

    Parameters
    ----------
    radiance
        Radiance per lux, shape (rows, columns).
    side
        "left" or "right".
    width, height
        Size of the view in pixels.
    period_s
        Duration of one pan there and back.
    """

    def __init__(
        self, radiance: NDArray[np.float32], side: str, width: int, height: int, period_s: float = 24.0
    ) -> None:
        rows, columns = radiance.shape
        scale = max(1.0, ROOM_TO_PAN * height / rows, ROOM_TO_PAN * width / columns)
        size = (math.ceil(columns * scale), math.ceil(rows * scale))
        self._still = cv2.resize(radiance, size, interpolation=cv2.INTER_LINEAR) if scale > 1.0 else radiance
        self._size = (width, height)
        self._shift_px = DISPARITY_PX if side == "right" else 0.0
        self._period_s = period_s

    def exposed(self, start_s: float, exposure_s: float, lux: float) -> NDArray[np.float32]:
        """Mean radiance over an exposure, in lux times reflectance, shape (height, width), float32."""
        shift_px = math.dist(self._centre(start_s), self._centre(start_s + exposure_s))
        instants = min(max(math.ceil(shift_px / _BLUR_STEP_PX), 1), _MOST_INSTANTS)
        total = np.zeros(self._size[::-1], np.float32)
        for part in range(instants):
            x, y = self._centre(start_s + exposure_s * (part + 0.5) / instants)
            total += cv2.getRectSubPix(self._still, self._size, (x + self._shift_px, y))
        total *= np.float32(lux / instants)
        return total

    def tints(self, time_s: float) -> Tints:
        """Grey everywhere, see `Scene`: only the luminance of the still is known."""
        return grey_light(self._size[::-1])

    def _centre(self, time_s: float) -> tuple[float, float]:
        """Middle of the left camera's view on the still, in its pixels."""
        rows, columns = self._still.shape
        phase = 2.0 * math.pi * max(time_s, 0.0) / self._period_s
        reach_x = (columns - self._size[0] - DISPARITY_PX) / 2.0
        reach_y = (rows - self._size[1]) / 2.0
        # Only cosines, so that the pan starts at rest.
        x = (columns - DISPARITY_PX) / 2.0 - reach_x * math.cos(phase)
        y = rows / 2.0 + reach_y * 0.5 * (1.0 - math.cos(2.0 * phase))
        return x, y
