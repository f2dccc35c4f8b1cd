"""The interface of policies: what one sees of a frame, and what it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.decision import Grounds
from autoexpose_daemon.control.metrics.gradient import mean_signal
from autoexpose_daemon.control.snapshot import Built, Stateful
from autoexpose_daemon.control.step import StepInputs
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Side
from imaging.response import ResponseFunction

MISSED_FRAMES = 12
"""Frames of a camera that may be lost in a row, a fifth of a second at 60 Hz, before the other decides without it."""


@dataclass(frozen=True, slots=True)
class PastStep:
    """A decision whose outcome a later frame shows.

    Attributes
    ----------
    setting
        What was decided.
    level, metric
        Exposure level (stops) of the frame it was decided on, and its M_g as in `Observation`.
    target
        What the policy wanted, before bounds and increments made it `setting`.
    """

    setting: ExposureSetting
    level: float
    metric: float | None
    target: Target

    @property
    def predicted_metric(self) -> float | None:
        """M_g that the policy predicted for frames taken with `setting`; None if it predicted nothing."""
        return self.target.predicted_metric


@dataclass(frozen=True, eq=False)
class Look:
    """What control sees of one camera's frame.

    Attributes
    ----------
    side
        Which camera it is.
    image
        The shrunk frame (`ImagePreparation`), uint8, (height, width). Valid during this step only.
    response
        The camera's response function.
    weights
        How much each pixel of `image` counts, uint8 of its shape; None: all alike. The figures of an `Observation`
        respect them; a policy that looks at pixels must, too.
    before_median
        See `unfiltered`; None: `image` has had no median.
    scale
        Width of the frame over that of `image`.
    averaged
        How many samples of the sensor were averaged into a pixel of `image`.
    relative_light
        What the lens lets through to each of the 8x8 cells of the picture, row by row, float64, shape (64,), to a
        quarter of a stop; None: not known.
    setting
        Exposure time and gain that the frame was taken with; None: as the reference frame.
    device_time_ns
        Its time stamp, on its camera's clock, which has nothing to do with another camera's.
    """

    side: Side
    image: NDArray[np.uint8]
    response: ResponseFunction
    weights: NDArray[np.uint8] | None = None
    before_median: NDArray[np.uint8] | None = None
    scale: float = 1.0
    averaged: float = 1.0
    relative_light: NDArray[np.float64] | None = None
    setting: ExposureSetting | None = None
    device_time_ns: int = 0

    @property
    def unfiltered(self) -> NDArray[np.uint8]:
        """`image` before the median, whose noise is the camera's, averaged."""
        return self.image if self.before_median is None else self.before_median


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Everything a policy may look at.

    Attributes
    ----------
    looks
        The frames, the reference first: the left camera's, unless it is missing or `ExposurePolicy.uncounted`.
        Everything else refers to it.
    setting
        Exposure time and gain that the frame was actually taken with.
    metric
        M_g of `image`, 0..1 per pixel; may be None for a policy that is not `FILTERED`.
    saturated_share, black_share
        Shares (0..1) of the pixels of `image` at or beyond saturation and the black level.
    motion_px
        Mean speed of image points, pixels of full resolution per 1/60 s.
    limits
        Bounds and increments that the next setting will be cut to.
    inputs
        What the step was given; its frames are for those who made `looks`.
    past
        The latest decisions, oldest first, one per frame.
    flicker_hz
        Flashes of the light per second: the next exposure time will be whole periods, if they fit; None: any time.
    ev_stops
        The EV compensation by which frames will differ from targets.
    """

    looks: Sequence[Look]
    setting: ExposureSetting
    metric: float | None
    saturated_share: float
    black_share: float
    motion_px: float
    limits: ExposureLimits
    inputs: StepInputs
    past: Sequence[PastStep] = ()
    flicker_hz: float | None = None
    ev_stops: float = 0.0

    @property
    def side(self) -> Side:
        """The camera of the reference frame."""
        return self.looks[0].side

    @property
    def image(self) -> NDArray[np.uint8]:
        """The shrunk reference frame."""
        return self.looks[0].image

    @property
    def weights(self) -> NDArray[np.uint8] | None:
        """How much each pixel of `image` counts."""
        return self.looks[0].weights

    @property
    def mean(self) -> float:
        """Mean signal of `image`, 0 at the black level to 1 at saturation."""
        look = self.looks[0]
        return mean_signal(look.image, look.response, look.weights)

    @property
    def realised(self) -> PastStep | None:
        """The latest of `past` that this frame was taken with; None if none fits its setting."""
        return next((past for past in reversed(self.past) if past.setting.agrees_with(self.setting)), None)

    def realises(self, target: Target) -> bool:
        """Whether this frame was taken because `target` was asked for.

        A policy that asks for query images recognises its answers by this; it never counts frames, since cameras
        take one to three of them to show a setting.
        """
        past = self.realised
        return past is not None and (past.target.level, past.target.exposure_time_us) == (
            target.level,
            target.exposure_time_us,
        )


@dataclass(frozen=True, slots=True)
class Target:
    """What a policy wants.

    Attributes
    ----------
    level
        The exposure level to take next (stops): absolute, not a change, so frames in flight are never corrected twice.
    reason
        Why, in a few words for the user.
    predicted_metric
        M_g expected at `level`; None when the policy does not predict.
    exposure_time_us
        The time, from a policy that chooses time and gain itself; the gain is what `level` leaves. None: split by the
        policy's balance.
    """

    level: float
    reason: str
    predicted_metric: float | None = None
    exposure_time_us: float | None = None


Objective = Literal["metric", "information"]
"""What makes a frame good: gradient information M_g, or the Fisher information of its gradients (docs/policy.md)."""


class ExposurePolicy(Stateful, ABC):
    """Decides on one exposure level per stereo pair. One that is in the table also has a class method `build(setup)`.

    What a policy carries from frame to frame is plain data in the attributes that it annotates: see `snapshot`.

    Attributes
    ----------
    FLOW
        How motion is measured unless another way is configured: Farneback's flow for papers that measure it so.
    OBJECTIVE
        What it is judged by.
    compensated
        How it gets an EV compensation: `targets`, its targets are levels that do not depend on the frames they are
        based on, so the compensation is added to them; `frames`, it is shown frames without the compensation;
        `darker`, the same, but none above 0, since it is guided by what that would saturate.
    STEERED
        Whether it uses `StepInputs.steering`.
    FILTERED
        Whether it needs images that have had a median, as M_g does, which is measured only then.
    balance
        How the level is split into time and gain.
    """

    FLOW: ClassVar[Literal["tiles", "farneback"]] = "tiles"
    OBJECTIVE: ClassVar[Objective] = "metric"
    compensated: Built[Literal["targets", "frames", "darker"]] = "darker"
    STEERED: ClassVar[bool] = False
    FILTERED: ClassVar[bool] = True
    balance: Built[Balance]

    @property
    def light_belief(self) -> float | None:
        """How far light ahead is believed, 0 to 1; None: the policy uses none."""
        return None

    @property
    def uncounted(self) -> Mapping[Side, str]:
        """The cameras whose frames do not count at present, and why, in words to follow "left camera"."""
        return {}

    @property
    def grounds(self) -> Grounds | None:
        """What the latest decision rests on, made when it is asked for; None: none yet, or the policy has no belief."""
        return None

    def balance_for(self, look: Look) -> Balance:
        """The `balance` for frames of this size."""
        return self.balance

    @abstractmethod
    def decide(self, observation: Observation) -> Target:
        """The target for the frame to be taken next."""
