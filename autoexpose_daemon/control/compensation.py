"""EV compensation: the world as a policy sees it without."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from autoexpose_daemon.control.metrics.gradient import ExtremeShares
from autoexpose_daemon.control.policy import Look
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.frames import Side
from imaging.response import ResponseFunction, prediction_table

MOSTLY = 0.5
"""Share of saturated pixels above which they are taken to be saturated even without the compensation."""


class Compensation:
    """Shows a policy the world without the EV compensation, so that it neither sees nor fights it.

    The policy's camera has a gain lower by the compensation: the same photons and the same exposure time, but pixels
    as the response predicts them for so many stops less, and limits and settings with that much less gain. What the
    policy wants there, plus the compensation, is what the cameras get.

    The brightness of what only the compensation saturates is lost: the larger its share of the frame, the brighter
    it is taken to be, from just saturated with the compensation to saturated without it.

    Parameters
    ----------
    stops
        The compensation.
    responses
        Response function of each camera.
    limits
        Limits of the cameras.

    Attributes
    ----------
    limits
        Limits for the policy.
    """

    def __init__(self, stops: float, responses: Mapping[Side, ResponseFunction], limits: ExposureLimits) -> None:
        self.stops = stops
        gain_db = stops * DB_PER_STOP
        # Levels only: no policy that sees these frames splits one into time and gain by increments.
        self.limits = ExposureLimits(
            limits.min_time_us, limits.max_time_us, limits.min_gain_db - gain_db, limits.max_gain_db - gain_db
        )
        self._tables = {side: prediction_table(response, -stops) for side, response in responses.items()}
        self._shares = {side: ExtremeShares(response) for side, response in responses.items()}

    def setting(self, setting: ExposureSetting) -> ExposureSetting:
        """A setting of the cameras, for the policy."""
        return replace(setting, gain_db=setting.gain_db - self.stops * DB_PER_STOP)

    def look(self, look: Look) -> Look:
        """What the policy sees of a frame."""
        table, shares = self._tables[look.side], self._shares[look.side]
        saturated, _ = shares.measure(look.image, look.weights)
        if self.stops > 0 and saturated > 0:
            left = self.stops * max(1.0 - saturated / MOSTLY, 0.0)
            brighter = prediction_table(look.response, -left)
            table = np.concatenate([table[: shares.saturated_from], brighter[shares.saturated_from :]])
        before_median = None if look.before_median is None else table[look.before_median]
        return replace(look, image=table[look.image], before_median=before_median)
