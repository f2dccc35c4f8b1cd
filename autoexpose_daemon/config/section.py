"""What sections of the configuration have in common: known keys, numbers within bounds, areas, words for mistakes."""

from __future__ import annotations

import difflib
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from autoexpose_daemon.control.policies.ids import REMOVED, check_policy_id
from autoexpose_daemon.messages.keys import check_endpoints, check_zenoh_file
from documents import bounds
from documents.text import quoted, shortened
from imaging.errors import ConfigurationError
from imaging.python310 import Self

log = logging.getLogger(__name__)

LONGEST_NAME = 64
MOST_RECTANGLES = 256
_LONGEST_PATH = 4096


def _refuse_boolean(value: object) -> object:
    if isinstance(value, bool):  # YAML reads yes, no, on and off as booleans, which Python takes for 1 and 0
        raise ValueError(f"{str(value).lower()} is not a number")
    return value


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
PhaseMs = Annotated[Float, AfterValidator(bounds.PHASE_MS.check)]
ExposureTimeUs = Annotated[Float, AfterValidator(bounds.EXPOSURE_TIME_US.check)]
ExposureCountUs = Annotated[Float, AfterValidator(bounds.EXPOSURE_COUNT_US.check)]
GainDb = Annotated[Float, AfterValidator(bounds.GAIN_DB.check)]
OffsetStops = Annotated[Float, AfterValidator(bounds.OFFSET_STOPS.check)]
Weight = Annotated[Float, AfterValidator(bounds.WEIGHT.check)]
Pixel = Annotated[Integer, AfterValidator(bounds.PIXEL.check)]
Extent = Annotated[Integer, AfterValidator(bounds.EXTENT.check)]
Binning = Annotated[Integer, AfterValidator(bounds.BINNING.check)]
LinkMbps = Annotated[Float, AfterValidator(bounds.LINK_MBPS.check)]
PacketBytes = Annotated[Integer, AfterValidator(bounds.PACKET_BYTES.check)]
EvStops = Annotated[Float, AfterValidator(bounds.EV_STOPS.check)]
UtcOffsetS = Annotated[Integer, AfterValidator(bounds.UTC_OFFSET_S.check)]
SampleAgeS = Annotated[Float, AfterValidator(bounds.SAMPLE_AGE_S.check)]
Name = Annotated[str, AfterValidator(check_name)]
FileName = Annotated[Path, AfterValidator(_check_path)]


class Section(BaseModel):
    """Unknown keys are errors: a misspelt limit must not silently mean no limit."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class RectangleConfig(Section):
    """A rectangle in pixels of the camera's frames, `[x, y, width, height]`, and how much its pixels count."""

    box: tuple[Pixel, Pixel, Extent, Extent]
    weight: Weight = 1.0


class AreaConfig(Section):
    """What counts in the picture of one camera: rectangles, and everything else."""

    rectangles: Annotated[tuple[RectangleConfig, ...], Field(max_length=MOST_RECTANGLES)] = ()
    background_weight: Weight = 0.0


def error_sentences(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """A sentence for each thing that is wrong with data for a model, beginning with its key."""
    return [_error_sentence(each, model) for each in error.errors()]


def _error_sentence(error: ErrorDetails, model: type[BaseModel]) -> str:
    key = ".".join(shortened(str(part)) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        *parents, last = [str(part) for part in error["loc"]]
        known = _keys_of(parents, model)
        near = difflib.get_close_matches(last, known, n=1)
        hint = f"did you mean {'.'.join([*parents, near[0]])}?" if near else f"known: {', '.join(known)}"
        return f"{key}: unknown key; {hint}"
    if error["loc"][-1:] == ("[key]",):
        section = ".".join(shortened(str(part)) for part in error["loc"][:-2])
        return f"{section}: {quoted(error['input'])} is no name to YAML: put it in quotes"
    if error["type"] in ("model_type", "dict_type") and key:
        return f"{key}: is {'empty' if error['input'] is None else 'no section'}: give keys below it, or remove it"
    if error["type"] == "missing":
        return f"{key}: is missing"
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] != "value_error" and key:
        return f"{key}: is {quoted(error['input'])}: {message[0].lower()}{message[1:]}"
    return f"{key + ': ' if key else ''}{message[0].lower()}{message[1:]}"


def _keys_of(parents: list[str], model: type[BaseModel]) -> list[str]:
    """The known keys below a path of keys, taken from the models themselves."""
    named = False  # what comes next is a name that the user chose, such as that of a camera
    for parent in parents:
        if named or parent.isdecimal():  # a place in a list
            named = False
            continue
        kinds = list(_kinds(model.model_fields[parent].annotation))
        named = dict in kinds
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel))
    return list(model.model_fields)


def _kinds(annotation: Any) -> Iterator[Any]:
    """The plain types that a type is made of."""
    inner = get_args(annotation)
    yield get_origin(annotation) if inner else annotation
    for each in inner:
        yield from _kinds(each)


@contextmanager
def said_of(key: str) -> Iterator[None]:
    """Put a key in front of what a ConfigurationError says."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(f"{key}: {error}") from error


class ConnectionConfig(Section):
    """Endpoints for zenoh, or a zenoh configuration file instead."""

    connect: tuple[str, ...] = ()
    zenoh: FileName | None = None

    @field_validator("listen", "connect", check_fields=False)
    @classmethod
    def _endpoints_are_endpoints(cls, endpoints: tuple[str, ...] | None) -> tuple[str, ...] | None:
        check_endpoints(endpoints or ())
        return endpoints

    @model_validator(mode="after")
    def _endpoints_stand_in_one_place(self) -> Self:
        twice = [name for name in ("listen", "connect") if name in self.model_fields_set]
        if self.zenoh is not None and twice:
            raise ValueError(f"the zenoh configuration file names the endpoints: remove {' and '.join(twice)}")
        return self

    def relative_to(self, folder: Path, section: str) -> Self:
        """The same with its file relative to `folder`; ConfigurationError names `section` if zenoh cannot use it."""
        if self.zenoh is None:
            return self
        file = folder / self.zenoh
        try:
            check_zenoh_file(file)
        except ConfigurationError as error:
            raise ConfigurationError(f"{section}.zenoh: {error}") from error
        return self.model_copy(update={"zenoh": file})


ANY_POLICY: Final = {"any_policy": True}
"""The context of a validation in which a policy need not be known here."""


def _existing(policy: str, about: ValidationInfo) -> str:
    if about.context is not ANY_POLICY:
        check_policy_id(policy)
    return policy


PolicyId = Annotated[str, BeforeValidator(lambda name: present_name("policy", name)), AfterValidator(_existing)]
"""One of the policies; the name of one that is no longer here gets what took its place."""


class LimitsConfig(Section):
    """Some bounds of the exposure; None: unchanged."""

    min_time_us: ExposureTimeUs | None = None
    max_time_us: ExposureTimeUs | None = None
    min_gain_db: GainDb | None = None
    max_gain_db: GainDb | None = None

    @model_validator(mode="after")
    def _names_one(self) -> Self:
        if not self.model_dump(exclude_none=True):
            raise ValueError(f"no limit is named: give {', '.join(type(self).model_fields)}, or some of them")
        return self
