"""What all sections of the configuration have in common: known keys, numbers within bounds, printable names."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from autoexpose_daemon.control.parameters import BRACKET_RANGES, RANGES
from autoexpose_daemon.control.policies.removed import REMOVED
from documents import bounds
from documents.text import quoted

log = logging.getLogger(__name__)

LONGEST_NAME = 64
_LONGEST_PATH = 4096


def _refuse_boolean(value: object) -> object:
    if isinstance(value, bool):  # YAML reads yes, no, on and off as booleans, which Python takes for 1 and 0
        raise ValueError(f"{str(value).lower()} is not a number")
    return value


def _hertz_or_auto(value: object, parse: ValidatorFunctionWrapHandler) -> object:
    if value == "auto":
        return value
    try:
        return RANGES["flicker_hz"].check(parse(value))
    except ValueError as error:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        wrong = "is out of bounds" if number else "is not a frequency"
        raise ValueError(f"{quoted(value)} {wrong}: give {RANGES['flicker_hz']}, or auto") from error


def check_name(name: str) -> str:
    """A name that belongs to a camera; raises ValueError for one that is invisible, or could control a terminal."""
    if not 0 < len(name) <= LONGEST_NAME or name != name.strip() or not name.isprintable():
        raise ValueError(
            f"{quoted(name)} is not a valid name: give 1 to {LONGEST_NAME} printable characters without blanks around "
            "them"
        )
    return name


def present_name(key: str, name: object) -> object:
    """A name given for a key, or what took its place if it is `REMOVED`, with a warning."""
    present = REMOVED[key.rpartition(".")[2]].get(name) if isinstance(name, str) else None
    if present is None:
        return name
    log.warning("%s: there is no %s any more: %s takes its place", key, name, present)
    return present


def _check_path(path: Path) -> Path:
    if len(os.fsencode(path)) > _LONGEST_PATH:
        raise ValueError(f"{quoted(str(path))} is too long for the name of a file")
    return path


Float = Annotated[float, BeforeValidator(_refuse_boolean)]
Integer = Annotated[int, BeforeValidator(_refuse_boolean)]

RateHz = Annotated[Float, AfterValidator(bounds.RATE_HZ.check)]
ExposureTimeUs = Annotated[Float, AfterValidator(bounds.EXPOSURE_TIME_US.check)]
ExposureCountUs = Annotated[Float, AfterValidator(bounds.EXPOSURE_COUNT_US.check)]
GainDb = Annotated[Float, AfterValidator(bounds.GAIN_DB.check)]
Weight = Annotated[Float, AfterValidator(bounds.WEIGHT.check)]
Pixel = Annotated[Integer, AfterValidator(bounds.PIXEL.check)]
Extent = Annotated[Integer, AfterValidator(bounds.EXTENT.check)]
Binning = Annotated[Integer, AfterValidator(bounds.BINNING.check)]
LinkMbps = Annotated[Float, AfterValidator(bounds.LINK_MBPS.check)]
PacketBytes = Annotated[Integer, AfterValidator(bounds.PACKET_BYTES.check)]
MetricDelta = Annotated[Float, AfterValidator(RANGES["metric_delta"].check)]
MetricLambda = Annotated[Float, AfterValidator(RANGES["metric_lambda"].check)]
BalanceWeight = Annotated[Float, AfterValidator(RANGES["balance_weight"].check)]
BalanceOffset = Annotated[Float, AfterValidator(RANGES["balance_offset"].check)]
MeanTarget = Annotated[Float, AfterValidator(RANGES["mean_target"].check)]
FlickerHz = Annotated[Float | Literal["auto"], WrapValidator(_hertz_or_auto)]
FocalLengthPx = Annotated[Float, AfterValidator(RANGES["focal_length_px"].check)]
FullWellE = Annotated[Float, AfterValidator(RANGES["full_well_e"].check)]
ReadNoiseE = Annotated[Float, AfterValidator(RANGES["read_noise_e"].check)]
BracketExposures = Annotated[Integer, AfterValidator(BRACKET_RANGES["exposures"].check)]
BracketStops = Annotated[Float, AfterValidator(BRACKET_RANGES["range_stops"].check)]
EvStops = Annotated[Float, AfterValidator(bounds.EV_STOPS.check)]
SampleAgeS = Annotated[Float, AfterValidator(bounds.SAMPLE_AGE_S.check)]
Name = Annotated[str, AfterValidator(check_name)]
FileName = Annotated[Path, AfterValidator(_check_path)]


class Section(BaseModel):
    """Unknown keys are errors: a misspelt limit must not silently mean no limit."""

    model_config = ConfigDict(extra="forbid", frozen=True)
