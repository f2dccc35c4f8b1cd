"""What one step of the loop decides."""

from __future__ import annotations

from dataclasses import dataclass

from imaging.exposure import ExposureSetting


@dataclass(frozen=True, slots=True)
class Decision:
    """The next setting for both cameras, and what it is based on.

    Attributes
    ----------
    setting
        Exposure time (us) and gain (dB), within the limits and on their increments.
    level
        The exposure level aimed at (stops), within the limits, before quantisation.
    reason
        Why, in a few words for the user.
    metric
        M_g of the reference frame, 0..1 per pixel (eq. 5): the left one, unless it is missing or not counted;
        None: nobody asked for it.
    saturated_share, black_share
        Shares (0..1) of the reference frame's pixels at or above saturation, and at or below the black level.
    motion_px
        Mean speed of image points of the reference frame, pixels of full resolution per 1/60 s.
    """

    setting: ExposureSetting
    level: float
    reason: str
    metric: float | None
    saturated_share: float
    black_share: float
    motion_px: float
