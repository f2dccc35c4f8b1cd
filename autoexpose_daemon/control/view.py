"""How control sees one camera: what of its frames, with which weights; and what a policy sees under EV compensation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import CELLS
from autoexpose_daemon.control.metrics.gradient import ExtremeShares
from autoexpose_daemon.control.picture.image import ImagePreparation, Region
from autoexpose_daemon.control.policy import Look
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame
from imaging.pixels import MOSAIC_SHARE, is_mosaic
from imaging.response import ResponseFunction, prediction_table
from imaging.vignetting import Vignetting


class View:
    """Makes looks of one camera's frames; without a region everything counts, without vignetting as frames show it."""

    def __init__(
        self, response: ResponseFunction, region: Region | None = None, vignetting: Vignetting | None = None
    ) -> None:
        self.shares = ExtremeShares(response)
        self._response = response
        self._preparation = ImagePreparation()
        self._region, self._vignetting = region, vignetting
        self._relative_light: NDArray[np.float64] | None = None
        if vignetting is not None:  # to a quarter of a stop: few levels, and none of them costs much
            light = vignetting.relative_light(CELLS, CELLS).astype(np.float64).ravel()
            self._relative_light = np.exp2(np.round(4.0 * np.log2(light)) / 4.0)
        self._weights: NDArray[np.uint8] | None = None
        self._shape: tuple[int, ...] = ()

    def look(self, camera: CameraName, frame: Frame, *, filtered: bool = True) -> Look:
        """What a policy sees of a frame, valid until the next call; `filtered`: with the median."""
        grey = frame.grey8(self._response.saturation)
        image = self._preparation.prepare(grey, filtered=filtered)
        if frame.pixels.shape != self._shape:
            height, width = frame.pixels.shape[:2]
            if self._region is not None:
                self._weights = self._region.weights((height, width), grey.shape)
            if self._vignetting is not None:
                self._vignetting.check_size((width, height), f"the {camera} camera")
            self._shape = frame.pixels.shape
        scale = frame.pixels.shape[1] / image.shape[1]
        counted = MOSAIC_SHARE if is_mosaic(frame.layout) else 1.0
        averaged = counted * scale**2
        unfiltered, light = self._preparation.unfiltered, self._relative_light
        return Look(
            camera, image, self._response, self._weights, unfiltered, scale, averaged, light, frame.setting,
            frame.device_time_ns,
        )  # fmt: skip


MOSTLY = 0.5
"""Share of saturated pixels above which they are taken to be saturated even without the compensation."""


class Compensation:
    """Shows a policy the world without the EV compensation, so that it neither sees nor fights it.

    The policy's camera has a gain lower by the compensation: the same photons and the same exposure time, but pixels
    as the response predicts them for so many stops less, and limits and settings with that much less gain. What the
    policy wants there, plus the compensation, is what the cameras get.

    The brightness of what only the compensation saturates is lost: the larger its share of the frame, the brighter
    it is taken to be, from just saturated with the compensation to saturated without it.
    """

    def __init__(self, stops: float, responses: Mapping[CameraName, ResponseFunction], limits: ExposureLimits) -> None:
        self.stops = stops
        gain_db = stops * DB_PER_STOP
        # For the policy. Levels only: no policy that sees these frames splits one into time and gain by increments.
        self.limits = ExposureLimits(
            limits.min_time_us, limits.max_time_us, limits.min_gain_db - gain_db, limits.max_gain_db - gain_db
        )
        self._tables = {camera: prediction_table(response, -stops) for camera, response in responses.items()}
        self._shares = {camera: ExtremeShares(response) for camera, response in responses.items()}

    def setting(self, setting: ExposureSetting) -> ExposureSetting:
        """A setting of the cameras, for the policy."""
        return replace(setting, gain_db=setting.gain_db - self.stops * DB_PER_STOP)

    def look(self, look: Look) -> Look:
        """What the policy sees of a frame."""
        table, shares = self._tables[look.camera], self._shares[look.camera]
        saturated, _ = shares.measure(look.image, look.weights)
        if self.stops > 0 and saturated > 0:
            left = self.stops * max(1.0 - saturated / MOSTLY, 0.0)
            brighter = prediction_table(look.response, -left)
            table = np.concatenate([table[: shares.saturated_from], brighter[shares.saturated_from :]])
        before_median = None if look.before_median is None else table[look.before_median]
        return replace(look, image=table[look.image], before_median=before_median)
