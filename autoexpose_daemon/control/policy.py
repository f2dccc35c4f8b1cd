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
from imaging.frames import CameraName
from imaging.response import ResponseFunction

MISSED_FRAMES = 12
"""Frames of a camera that may be lost in a row, a fifth of a second at 60 Hz, before the other decides without it."""

SMALLEST_SIGNAL = 0.5 / 255
"""Mean of a black image, at most half a grey level: less would ask for infinitely many stops."""


@dataclass(frozen=True, slots=True)
class PastStep:
    """A decision whose outcome a later frame shows."""

    setting: ExposureSetting  # what was decided
    # exposure level (stops) of the frame it was decided on, and its M_g as in `Observation`
    level: float
    metric: float | None
    target: Target  # what the policy wanted, before bounds and increments made it `setting`


@dataclass(frozen=True, eq=False)
class Look:
    """What control sees of one camera's frame."""

    camera: CameraName  # which camera it is
    # the shrunk frame (`ImagePreparation`), uint8, (height, width). Valid during this step only
    image: NDArray[np.uint8]
    response: ResponseFunction  # the camera's response function
    # how much each pixel of `image` counts, uint8 of its shape; None: all alike. The figures of an `Observation`
    # respect them; a policy that looks at pixels must, too
    weights: NDArray[np.uint8] | None = None
    before_median: NDArray[np.uint8] | None = None  # see `unfiltered`; None: `image` has had no median
    scale: float = 1.0  # width of the frame over that of `image`
    averaged: float = 1.0  # how many samples of the sensor were averaged into a pixel of `image`
    # what the lens lets through to each of the 8x8 cells of the picture, row by row, float64, shape (64,), to a quarter
    # of a stop; None: not known
    relative_light: NDArray[np.float64] | None = None
    # exposure time and gain that the frame was taken with; None: as the reference frame
    setting: ExposureSetting | None = None
    device_time_ns: int = 0  # its time stamp, on its camera's clock, which has nothing to do with another camera's

    @property
    def unfiltered(self) -> NDArray[np.uint8]:
        """`image` before the median, whose noise is the camera's, averaged."""
        return self.image if self.before_median is None else self.before_median


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Everything a policy may look at."""

    # the frames, the reference first: the first camera's, unless it is missing or `ExposurePolicy.uncounted`.
    # Everything else refers to it
    looks: Sequence[Look]
    setting: ExposureSetting  # exposure time and gain that the frame was actually taken with
    metric: float | None  # M_g of `image`, 0..1 per pixel; may be None for a policy that is not `FILTERED`
    # shares (0..1) of the pixels of `image` at or beyond saturation and the black level
    saturated_share: float
    black_share: float
    motion_px: float  # mean speed of image points, pixels of full resolution per 1/60 s
    limits: ExposureLimits  # bounds and increments that the next setting will be cut to
    inputs: StepInputs  # what the step was given; its frames are for those who made `looks`
    past: Sequence[PastStep] = ()  # the latest decisions, oldest first, one per frame
    # flashes of the light per second: the next exposure time will be whole periods, if they fit; None: any time
    flicker_hz: float | None = None
    ev_stops: float = 0.0  # the EV compensation by which frames will differ from targets

    @property
    def camera(self) -> CameraName:
        """The camera of the reference frame."""
        return self.looks[0].camera

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
    """What a policy wants."""

    # the exposure level to take next (stops): absolute, not a change, so frames in flight are never corrected twice
    level: float
    reason: str  # why, in a few words for the user
    predicted_metric: float | None = None  # M_g expected at `level`; None when the policy does not predict
    # the time, from a policy that chooses time and gain itself; the gain is what `level` leaves. None: split by the
    # policy's balance
    exposure_time_us: float | None = None


Objective = Literal["metric", "information"]
"""What makes a frame good: gradient information M_g, or Fisher information of gradients (docs/understand/policy.md)."""


class ExposurePolicy(Stateful, ABC):
    """Decides on one exposure level per set of frames: derive from it, write `__init__` and `decide`.

    **Built** from a `ControlSetup` alone, again whenever limits or tuning change: `__init__(self, setup)`. It sets
    `balance`, how a level is split into exposure time and gain: `setup.balance()` is the configured one.

    **Called** once per set of frames, on one thread, with what is an `Observation`. Its images are small, 8 bits, grey
    (`Look.image`), valid during the call only; `Look.response` says what light a grey level stands for. Exposure times
    are in us, gains in dB, exposure levels in stops: log2 of time in us times linear gain, so one stop more is twice
    the light. A set may lack cameras, and images may be all black or all white.

    **Returns** a `Target`: the absolute level to take next, not a change, since one to four frames are always under way
    with earlier settings; `observation.setting.level` is that of the frame at hand. Others see to limits, increments,
    EV compensation, locks and flicker. What it raises, other than ConfigurationError, ends the daemon.

    **Remembers** plain data in the attributes that its class annotates, and nothing else: numbers, strings, None,
    tuples, lists, dictionaries with text as keys, dataclasses of these, and arrays of uint8, int16, float32 or float64.
    They are recorded, and a replay continues from them, so the same state and frames must give the same target: no
    clock, no random numbers without a seed, no files. What follows from `setup` alone has no annotation, or `Built`.
    """

    # how motion is measured unless another way is configured: Farneback's flow for papers that measure it so
    FLOW: ClassVar[Literal["tiles", "farneback"]] = "tiles"
    OBJECTIVE: ClassVar[Objective] = "metric"  # what it is judged by
    # how it gets an EV compensation: `targets`, its targets are levels that do not depend on the frames they are based
    # on, so the compensation is added to them; `frames`, it is shown frames without the compensation; `darker`, the
    # same, but none above 0, since it is guided by what that would saturate
    compensated: Built[Literal["targets", "frames", "darker"]] = "darker"
    STEERED: ClassVar[bool] = False  # whether it uses `StepInputs.steering`
    # whether it needs images that have had a median, as M_g does, which is measured only then
    FILTERED: ClassVar[bool] = True
    balance: Built[Balance]  # how the level is split into time and gain

    @property
    def light_belief(self) -> float | None:
        """How far light ahead is believed, 0 to 1; None: the policy uses none."""
        return None

    @property
    def uncounted(self) -> Mapping[CameraName, str]:
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
