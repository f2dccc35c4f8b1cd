"""What one step of the loop decides, and what that rests on, for people to look at."""

from __future__ import annotations

from dataclasses import dataclass

from imaging.exposure import ExposureSetting
from imaging.frames import CameraName


@dataclass(frozen=True, slots=True)
class SceneHistogram:
    """What light the scene sends one camera, as far as is known, by log radiance in bins of `bin_stops`.

    Radiance is in stops from what saturates at exposure level 0, so frames of level E are white from about -E on.
    """

    start: float  # lower bound of the first bin, stops
    bin_stops: float  # width of a bin
    known: list[float]  # share of the picture in each bin, as frames showed it
    guessed: list[float]  # share in each bin of what no frame has shown, which is clipped: where it is expected to lie
    # squared contrast in each bin, known or expected, as a share of all: it makes light worth showing
    contrast: list[float]
    # radiance between which the newest frame shows it
    black: float
    white: float


@dataclass(frozen=True, slots=True)
class Grounds:
    """What the latest decision of a policy that plans by a belief rests on."""

    scenes: dict[CameraName, SceneHistogram]  # what each camera faces
    level: float  # exposure level of the newest frame, stops
    levels: list[float]  # those that could be decided on, ascending
    worth: list[float]  # what a frame of each level would be worth by itself, as a share of the best
    # what decides: the same, summed over the frames that are planned, if the first has this level and the best follow,
    # less what changes of brightness cost, and with what the first would reveal
    value: list[float]

    @property
    def is_whole(self) -> bool:
        """Whether there is a worth and a value for each level, at least one."""
        return 0 < len(self.levels) == len(self.worth) == len(self.value)

    @property
    def best_level(self) -> float:
        """The level that is decided on, unless it is overridden: that of the largest value."""
        return self.levels[self.value.index(max(self.value))]


@dataclass(frozen=True, slots=True)
class Decision:
    """The next setting for cameras that are exposed together, and what it is based on."""

    setting: ExposureSetting  # exposure time (us) and gain (dB), within the limits and on their increments
    level: float  # the exposure level aimed at (stops), within the limits, before quantisation
    reason: str  # why, in a few words for the user
    # M_g of the reference frame, 0..1 per pixel (eq. 5): the left one, unless it is missing or not counted; None:
    # nobody asked for it
    metric: float | None
    # shares (0..1) of the reference frame's pixels at or above saturation, and at or below the black level
    saturated_share: float
    black_share: float
    motion_px: float  # mean speed of image points of the reference frame, pixels of full resolution per 1/60 s
