"""The tuning of the control loop that a user may change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, get_type_hints

from documents.bounds import Range
from imaging.errors import ConfigurationError

BalanceId = Literal["policy", "blur_noise", "exposure_priority", "fixed_ratio", "flicker"]
MotionId = Literal["policy", "farneback", "tiles"]

FASTEST_TURN_RAD_S = 100.0
"""A faster angular rate is not believed: the fastest gyroscopes measure up to 4000 degrees a second, 70 rad/s."""

FASTEST_M_S = 50.0
"""A robot that says it drives faster, or is told to, is not believed."""

REMEMBERED_STEPS = 32
"""Half a second at 60 Hz: the slowest camera reported takes 0.4 s from write to effect."""


@dataclass(frozen=True, slots=True)
class Bracketing:
    """How a drive is recorded in brackets. Raises ConfigurationError, which names a number that is out of bounds."""

    exposures: Annotated[int, Range(2, 12)] = 6  # shots in a cycle
    range_stops: Annotated[float, Range(1.0, 16.0, "stops")] = 6.0  # from the darkest to the brightest
    keep: bool = False  # whether one more frame of each cycle is exposed by the policy

    def __post_init__(self) -> None:
        _check(self, BRACKET_RANGES)


@dataclass(frozen=True, slots=True)
class ControlParameters:
    """Tuning; the defaults are those of Begin & Hunter 2022 (section 1.1, 2.1 and 3.3).

    Raises ConfigurationError, which names a parameter that is out of bounds.
    """

    # delta of eq. (3), the smallest gradient that counts, as a share of full scale
    metric_delta: Annotated[float, Range(0.0, 0.99)] = 0.30
    # lambda of eq. (3), which raises weak gradients relative to strong ones
    metric_lambda: Annotated[float, Range(0.001, 1_000_000.0)] = 1000.0
    # w of eq. (25): how much gain costs compared with motion blur
    balance_weight: Annotated[float, Range(0.000_001, 1000.0)] = 0.02
    balance_offset: Annotated[float, Range(0.0, 1_000_000.0)] = 8.0  # k_offset of eq. (25)
    # mean signal that `neves2009` holds, as a share of saturation
    mean_target: Annotated[float, Range(0.001, 0.999)] = 0.20
    # how a level is split into time and gain; `policy`: as in the policy's paper (its Table 1)
    balance: BalanceId = "policy"
    # flashes of the light per second, for the balance `flicker`: twice the mains frequency. None: found from the
    # frames, and times are whole periods whatever the balance
    flicker_hz: Annotated[float | None, Range(10.0, 1000.0, "Hz")] = 100.0
    # how motion is measured; `policy`: by Farneback's flow for the policies of Begin & Hunter, as in the paper, and by
    # tiles (`TileMotion`) for all others
    motion: MotionId = "policy"
    # of the left camera, in pixels of its frames; needed for steps that are given an angular rate. None: unknown
    focal_length_px: Annotated[float | None, Range(1.0, 100_000.0, "pixels")] = None
    # of the cameras' sensors, for our own policies: electrons that fill a pixel at 0 dB, and noise without light. The
    # defaults are those of common global shutters (Sony IMX273 and its kin)
    full_well_e: Annotated[float, Range(100.0, 10_000_000.0, "electrons")] = 10_500.0
    read_noise_e: Annotated[float, Range(0.1, 1000.0, "electrons")] = 3.0
    bracket: Bracketing | None = None  # record brackets instead of doing as the policy decides; None: do as it decides

    def __post_init__(self) -> None:
        _check(self, RANGES)


def _ranges(kind: type) -> dict[str, Range]:
    hints = get_type_hints(kind, include_extras=True)
    return {
        name: each for name, hint in hints.items() for each in getattr(hint, "__metadata__", ()) if type(each) is Range
    }


RANGES, BRACKET_RANGES = _ranges(ControlParameters), _ranges(Bracketing)
"""By parameter: beyond these bounds a value is a typo."""


def _check(parameters: object, ranges: Mapping[str, Range]) -> None:
    """Raise a ConfigurationError for a number out of its range; None is within any."""
    for name, range_ in ranges.items():
        value: float | None = getattr(parameters, name)
        if value is not None and value not in range_:
            raise ConfigurationError(f"{name} is {value:g}: give {range_}")
