"""How much brighter the scene has become from one frame to the next, whatever exposures the two were taken with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics import extension as _native
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.snapshot import Stateful
from imaging.frames import CameraName
from imaging.response import ResponseFunction

STRIDE = 5
"""Every fifth pixel across and down: some 3900 of 360x270 determine a median to 0.01 stop."""

LEAST_SHARE = 0.01
"""Of the compared pixels, which must be unclipped in both frames: a handful of them is noise, or one small thing."""

BETWEEN = 1
"""How a pixel that is not clipped is marked."""

MARGIN = 0.03
"""Of the range from black level to saturation: closer to the ends noise is clipped, and the median would be biased."""


@dataclass(frozen=True, slots=True)
class LightChange:
    """What two frames say about the light between them."""

    stops: float  # the rise of the light
    # whether enough pixels were unclipped in both frames; otherwise `stops` is only a bound, towards less change
    measured: bool


class LightRegistration(Stateful):
    """The median change of log radiance, with clipped pixels used as bounds.

    A pixel unclipped in both frames gives a change. One that is clipped in one of them gives a bound: saturated now, it
    changed by at least this much. The median sought is the M with as many pixels surely above as surely below it: the
    ordinary median when nothing is clipped. Without the bounds, a large change would be judged by the few pixels
    of extreme noise that remain unclipped.
    """

    camera: CameraName | None = None  # camera of the frame before; None before the first
    # grey levels of the frame before, every fifth across and down, uint8; None before the first
    previous: NDArray[np.uint8] | None = None
    previous_level: float = 0.0  # its exposure level, stops

    def __init__(self, responses: Mapping[CameraName, ResponseFunction]) -> None:
        self._tables = {camera: _tables(response) for camera, response in responses.items()}
        self._saturated = {
            camera: np.where(clipped > BETWEEN, np.uint8(255), np.uint8(0))
            for camera, (_, clipped) in self._tables.items()
        }

    def change(self, look: Look, level: float) -> LightChange | None:
        """The change of light since the frame before, which was taken by the same camera.

        None after a frame of another camera, and when no pixel shows any change. `level` is the exposure level of this
        frame, stops; pixels that weigh nothing do not count.
        """
        camera, before, level_change = self.camera, self.previous, level - self.previous_level
        now = self.remember(look, level)
        if before is None or camera != look.camera or before.shape != now.shape:
            return None
        counts = None if look.weights is None else np.ascontiguousarray(look.weights[::STRIDE, ::STRIDE])
        counted, known, median = _native.light_change(before, now, counts, *self._tables[look.camera])
        return None if math.isnan(median) else LightChange(median - level_change, known >= LEAST_SHARE * counted)

    def remember(self, look: Look, level: float) -> NDArray[np.uint8]:
        """Keep a frame for the next to be compared with; returns what is kept of it, as `previous`."""
        self.camera, self.previous, self.previous_level = look.camera, self._sampled(look), level
        return self.previous

    def _sampled(self, look: Look) -> NDArray[np.uint8]:
        """Every fifth pixel; one beside a saturated pixel was partly averaged from saturated ones, and counts as one.

        The edge of a white window against a black room stays grey at any exposure.
        """
        sampled = np.empty([-(-size // STRIDE) for size in look.image.shape], np.uint8)
        _native.sample_greys(look.image, STRIDE, self._saturated[look.camera], sampled)
        return sampled


def _tables(response: ResponseFunction) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """By grey level: log2 of the exposure behind it, and whether it is clipped: 0 below, 2 above, 1 `BETWEEN`."""
    margin = MARGIN * (response.saturation - response.black_level)
    # Near the black level one grey level is too large a part of the signal to be a logarithm.
    low = response.black_level + max(4.0, margin)
    high = response.saturation - margin
    greys = np.arange(256)
    log_exposure = response.inverse(np.clip(greys, round(low), round(high))).astype(np.float32)
    return log_exposure, (1 + (greys >= high) - (greys <= low)).astype(np.uint8)
