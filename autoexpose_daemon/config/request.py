"""What may be asked of control while it runs: a JSON object, checked as the configuration is."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Annotated, Any, Final

from pydantic import Field, ValidationError, field_validator, model_validator

from autoexpose_daemon.config.section import (
    ANY_POLICY,
    AreaConfig,
    EvStops,
    ExposureTimeUs,
    Extent,
    GainDb,
    LimitsConfig,
    Name,
    PolicyId,
    Section,
    error_sentences,
)
from documents.text import readable
from imaging.errors import ConfigurationError
from imaging.frames import CameraName
from imaging.python310 import Self

LARGEST_REQUEST_BYTES: Final = 1 << 15
"""Enough for a region of 256 rectangles, with room to spare."""

_LONGEST_SENTENCE: Final = 400

Flag = Annotated[bool, Field(strict=True)]


class ShotRequest(Section):
    """The setting of one pair."""

    exposure_time_us: ExposureTimeUs
    gain_db: GainDb = 0.0

    @property
    def words(self) -> str:
        """What is asked for, in words."""
        return f"shot {self.exposure_time_us:g} us, {self.gain_db:g} dB"


_Number = Annotated[float, Field(allow_inf_nan=False)]


class GeometryRequest(Section):
    """Lens and rectification of a camera, with the meaning of ROS's CameraInfo."""

    width: Extent
    height: Extent
    distortion_model: str
    d: Annotated[tuple[_Number, ...], Field(max_length=14)]
    k: Annotated[tuple[_Number, ...], Field(min_length=9, max_length=9)]
    r: Annotated[tuple[_Number, ...], Field(min_length=9, max_length=9)]
    p: Annotated[tuple[_Number, ...], Field(min_length=12, max_length=12)]


class Request(Section):
    """Changes to control, made all together or not at all; None and false leave things as they are."""

    by: Name  # who asks, in their own words: for the log
    group: Name | None = None  # whose cameras; None: all
    reset: Flag = False  # go back to the configuration first
    locked: Flag | None = None  # true: keep the setting that was decided last; False: let the policy decide again
    ev_stops: EvStops | None = None  # added to what the policy decides
    # used in place of those in the configuration
    policy: PolicyId | None = None
    limits: LimitsConfig | None = None
    region: dict[CameraName, AreaConfig | None] | None = None
    shot: ShotRequest | None = None  # the setting of one pair
    # of cameras, by name: kept for good, in place of the files of the configuration; goes with nothing else
    geometry: dict[CameraName, GeometryRequest | None] | None = None

    @field_validator("region")
    @classmethod
    def _names_a_camera(cls, region: dict[CameraName, AreaConfig | None] | None) -> object:
        if region is not None and not any(region.values()):
            raise ValueError("no camera is named: give a region by the name of each camera concerned")
        return region

    @model_validator(mode="after")
    def _geometry_is_alone(self) -> Self:
        if self.geometry is not None:
            if not any(self.geometry.values()):
                raise ValueError("geometry names no camera: give that of each camera concerned, by its name")
            if self.model_copy(update={"geometry": None}).words or self.group is not None:
                raise ValueError("geometry goes with nothing else: make two requests")
        return self

    def of(self, group: str | None, cameras: Collection[CameraName]) -> Request:
        """The same for a group with these cameras, without regions of others; None: there is no other group."""
        areas = {camera: area for camera, area in self.regions.items() if camera in cameras}
        return self.model_copy(update={"group": group, "region": areas or None})

    @property
    def only_regions(self) -> bool:
        """Whether it asks for nothing but regions of cameras."""
        return bool(self.regions) and not self.model_copy(update={"region": None}).words

    @property
    def regions(self) -> dict[CameraName, AreaConfig]:
        """Those that are asked for, by camera."""
        return {camera: area for camera, area in (self.region or {}).items() if area is not None}

    @property
    def words(self) -> str:
        """What is asked for, in words; empty: nothing."""
        return ", ".join(self._parts())

    @property
    def in_full(self) -> str:
        """What is asked for, of which group, and who asks."""
        return f"{self.words}{'' if self.group is None else f' of group {self.group}'}, asked by {self.by}"

    def _parts(self) -> Iterator[str]:
        if self.reset:
            yield "reset"
        if self.locked is not None:
            yield "lock" if self.locked else "unlock"
        if self.ev_stops is not None:
            yield f"EV {self.ev_stops:+g}" if self.ev_stops else "EV 0"
        if self.policy is not None:
            yield f"policy {self.policy}"
        if self.limits is not None:
            yield "limits " + " ".join(f"{name} {value:g}" for name, value in self.limits if value is not None)
        if self.regions:
            areas = {camera: len(area.rectangles) for camera, area in self.regions.items()}
            yield "region " + " and ".join(f"{camera} (rectangles: {count})" for camera, count in areas.items())
        if self.shot is not None:
            yield self.shot.words
        if self.geometry is not None:
            yield f"geometry {' and '.join(self.geometry)}"

    def to_json(self) -> str:
        """The text that is sent."""
        return self.model_dump_json(exclude_defaults=True)


def new_request(content: Mapping[str, Any]) -> Request:
    """A request; raises ConfigurationError, one sentence, if it is not valid.

    Which policies there are is for the daemon to know, perhaps on another machine.
    """
    try:
        return Request.model_validate(content, context=ANY_POLICY)
    except ValidationError as error:
        raise ConfigurationError(_sentence(error)) from error


def check_size(size_bytes: int) -> None:
    """Raise ConfigurationError for a message that is too large for a request."""
    if size_bytes > LARGEST_REQUEST_BYTES:
        raise ConfigurationError(f"a request of {size_bytes} bytes: give at most {LARGEST_REQUEST_BYTES}")


def read_request(data: bytes) -> Request:
    """The request in a message; raises ConfigurationError, one sentence, if it is damaged or not valid."""
    check_size(len(data))
    try:
        return Request.model_validate_json(data)
    except ValidationError as error:
        raise ConfigurationError(_sentence(error)) from error


def _sentence(error: ValidationError) -> str:
    """The first mistake, printable and of bounded length: it goes into logs and terminals."""
    text = readable(error_sentences(error, Request)[0])
    return text if len(text) <= _LONGEST_SENTENCE else f"{text[:_LONGEST_SENTENCE]}..."
