"""Sections `exposure` and `control`: the bounds, what counts in the pictures, and how control decides."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from autoexpose_daemon.config.section import (
    AreaConfig,
    ExposureTimeUs,
    FileName,
    Float,
    GainDb,
    Integer,
    PolicyId,
    Section,
    present_name,
)
from autoexpose_daemon.control.parameters import (
    BRACKET_RANGES,
    RANGES,
    BalanceId,
    Bracketing,
    ControlParameters,
    MotionId,
)
from autoexpose_daemon.control.picture.image import Rectangle, Region
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from documents.files import is_whole_png, read_regular
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits
from imaging.frames import CameraName
from imaging.python310 import Self

MOST_MASK_BYTES = 1 << 26
"""More than any sensor's mask needs as a PNG file: masks are mostly black and white."""


class RegionConfig(AreaConfig):
    """What counts in the picture of one camera, with a mask file too."""

    mask: FileName | None = None

    def relative_to(self, folder: Path) -> Self:
        """The same with its mask file below `folder`, unless that is absolute."""
        return self.model_copy(update={"mask": self.mask and folder / self.mask})


def region_of(key: str, area: AreaConfig) -> Region:
    """An area as a region that errors call `key`; raises ConfigurationError if nothing in it counts."""
    rectangles = tuple(Rectangle(*rectangle.box, rectangle.weight) for rectangle in area.rectangles)
    region = Region(key, rectangles, area.background_weight)
    region.check_something_counts()
    return region


def _region(camera: CameraName, config: RegionConfig) -> Region:
    key = f"control.roi.{camera}"
    if config.mask is None:
        return region_of(key, config)
    rectangles = tuple(Rectangle(*rectangle.box, rectangle.weight) for rectangle in config.rectangles)
    mask = _read_mask(f"{key}.mask", config.mask)
    region = Region(f"{key} ({config.mask})", rectangles, config.background_weight, mask)
    region.weights(mask.shape)  # only the frames show whether the mask has their size
    return region


def _read_mask(key: str, path: Path) -> NDArray[np.uint8]:
    """The grey levels of a mask file: uint8, shape (height, width)."""
    try:
        content = read_regular(path, MOST_MASK_BYTES)
    except OSError as error:
        raise ConfigurationError(f"{key}: {path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # a NUL in its name
        raise ConfigurationError(f"{key}: {quoted(str(path))}: is not a valid file name: {error}") from error
    mask = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if is_whole_png(content) else None
    if mask is None:
        raise ConfigurationError(f"{key}: {path}: is not a PNG picture: save the mask as one")
    if mask.ndim != 2 or mask.dtype != np.uint8:
        raise ConfigurationError(f"{key}: {path}: is not 8-bit grey without alpha: convert it")
    if not mask.any():
        raise ConfigurationError(f"{key}: {path}: is entirely black, so nothing would count: draw what counts in white")
    return mask.astype(np.uint8, copy=False)


class ExposureConfig(Section):
    """Bounds of the exposure; each is clipped to the camera's own."""

    min_time_us: ExposureTimeUs = 20.0
    max_time_us: ExposureTimeUs = 7500.0
    min_gain_db: GainDb = 0.0
    max_gain_db: GainDb = 30.0

    @model_validator(mode="after")
    def _leaves_a_choice(self) -> Self:
        self.limits()
        return self

    def limits(self) -> ExposureLimits:
        """The bounds as limits."""
        return ExposureLimits(self.min_time_us, self.max_time_us, self.min_gain_db, self.max_gain_db)


class StartConfig(Section):
    """The exposure before the first frame; the policy `fixed` stays there."""

    exposure_time_us: ExposureTimeUs
    gain_db: GainDb = 0.0


def _hertz_or_auto(value: object, parse: ValidatorFunctionWrapHandler) -> object:
    if value == "auto":
        return value
    try:
        return RANGES["flicker_hz"].check(parse(value))
    except ValueError as error:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        wrong = "is out of bounds" if number else "is not a frequency"
        raise ValueError(f"{quoted(value)} {wrong}: give {RANGES['flicker_hz']}, or auto") from error


_WITHIN = {name: AfterValidator(allowed.check) for name, allowed in {**RANGES, **BRACKET_RANGES}.items()}
_TUNING = ControlParameters()
_BRACKETING = Bracketing()


class BracketConfig(Section):
    """Brackets, recorded to judge policies later, instead of exposures by the policy."""

    exposures: Annotated[Integer, _WITHIN["exposures"]] = _BRACKETING.exposures
    range_stops: Annotated[Float, _WITHIN["range_stops"]] = _BRACKETING.range_stops
    keep: bool = _BRACKETING.keep


class ControlConfig(Section):
    """Which policy decides, where it starts, what it looks at, and how it is tuned."""

    policy: PolicyId = DEFAULT_POLICY
    start: StartConfig | None = None
    roi: dict[CameraName, RegionConfig | None] = {}  # by camera; without one, all of its picture counts
    balance: BalanceId = _TUNING.balance
    flicker_hz: Annotated[Float | Literal["auto"], WrapValidator(_hertz_or_auto)] = _TUNING.flicker_hz or "auto"
    motion: MotionId = _TUNING.motion
    focal_length_px: Annotated[Float, _WITHIN["focal_length_px"]] | None = _TUNING.focal_length_px
    full_well_e: Annotated[Float, _WITHIN["full_well_e"]] = _TUNING.full_well_e
    read_noise_e: Annotated[Float, _WITHIN["read_noise_e"]] = _TUNING.read_noise_e
    metric_delta: Annotated[Float, _WITHIN["metric_delta"]] = _TUNING.metric_delta
    metric_lambda: Annotated[Float, _WITHIN["metric_lambda"]] = _TUNING.metric_lambda
    balance_weight: Annotated[Float, _WITHIN["balance_weight"]] = _TUNING.balance_weight
    balance_offset: Annotated[Float, _WITHIN["balance_offset"]] = _TUNING.balance_offset
    mean_target: Annotated[Float, _WITHIN["mean_target"]] = _TUNING.mean_target
    bracket: BracketConfig | None = None

    @cached_property
    def regions(self) -> dict[CameraName, Region]:
        """The configured regions; their masks are read once.

        Raises ConfigurationError, which names the key and the file, for a mask that cannot be used.
        """
        return {camera: _region(camera, region) for camera, region in self.roi.items() if region is not None}

    def relative_to(self, folder: Path) -> Self:
        """The same with mask files below `folder`, unless they are absolute."""
        roi = {camera: region and region.relative_to(folder) for camera, region in self.roi.items()}
        return self.model_copy(update={"roi": roi})

    def parameters(self) -> ControlParameters:
        """What the control loop is tuned with."""
        values = {field.name: getattr(self, field.name) for field in fields(ControlParameters)}
        found = {"flicker_hz": None} if self.flicker_hz == "auto" else {}
        bracketing = None if self.bracket is None else Bracketing(**self.bracket.model_dump())
        return ControlParameters(**values | found | {"bracket": bracketing})

    @field_validator("policy", "motion", mode="before")
    @classmethod
    def _in_place_of_removed(cls, name: object, info: ValidationInfo) -> object:
        return present_name(f"control.{info.field_name}", name)
