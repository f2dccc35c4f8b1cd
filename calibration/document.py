"""What calibration files have in common: they are read and written here, and each finding is one sentence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, with_config
from pydantic_core import ErrorDetails

from documents.bounds import Range
from documents.files import replace_file
from documents.strict_yaml import load_mapping
from documents.text import quoted
from imaging.errors import ConfigurationError


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class Finding:
    """A reason not to believe a calibration."""

    # "refused": no result can be drawn from this; "warned": there is a result, with less trust
    severity: Literal["refused", "warned"]
    reason: str  # a short name that stays the same between versions, such as "light_drift"
    text: str  # one sentence: what was seen, in numbers, and what to do


Verdict = Literal["believe it", "with care", "refused"]


def verdict(findings: Sequence[Finding]) -> Verdict:
    """The worst of the findings, as advice."""
    severities = {finding.severity for finding in findings}
    return "refused" if "refused" in severities else "with care" if "warned" in severities else "believe it"


class Judged:
    """What has findings, and so a verdict: whether to believe it."""

    __slots__ = ()
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> Verdict:
        """The worst of the findings, as advice."""
        return verdict(self.findings)


@contextmanager
def located(place: object) -> Iterator[None]:
    """Begin what is wrong with a content, a ConfigurationError, with its place: a file, or a key."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(f"{place}: {error}") from error


@contextmanager
def written(path: Path) -> Iterator[None]:
    """Make what stops a file from being written a ConfigurationError that names the file."""
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written ({error.strerror}): choose another place") from error


D = TypeVar("D", bound=BaseModel)

Text = Annotated[str, Strict()]
Name = Annotated[str, Strict(), Field(min_length=1)]
Number = Annotated[float, Strict()]


def within(bounds: Range) -> Any:
    """The constraint of a number, beyond which it is a typo."""
    return Field(ge=bounds.low, le=bounds.high)


def optional(advice: str) -> Any:
    """A key that may be left out; `advice` is given after a bad value."""
    return Field(None, description=f"{advice}, or remove it")


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """The camera that a file belongs to."""

    vendor: Name
    model: Name
    serial: Name

    def check_is(self, serial: str, path: Path | None, measured_by: str) -> None:
        """Refuse the file at `path` for another camera; ConfigurationError names both and the command to measure."""
        if self.serial != serial:
            raise ConfigurationError(
                f"{path}: camera.serial is {self.serial}, but this is camera {serial}: name its own file, "
                f"or {to_calibrate(measured_by, serial)}"
            )


def to_calibrate(command: str, serial: str) -> str:
    """The advice to measure a camera."""
    return f"calibrate this one: autoexpose calibrate {command} --camera {serial}"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredFile:
    """What the file of a measurement says beside its result; None: it does not say."""

    camera: CameraIdentity | None = None
    date: datetime | None = None
    tool: str | None = None  # name and version of the program
    findings: tuple[Finding, ...] = ()  # what made the verdict `with care`
    path: Path | None = None  # where it was read from

    def check_camera(self, serial: str, measured_by: str) -> None:
        """Refuse a file of another camera. Raises ConfigurationError naming file, both cameras and what to do."""
        if self.camera is not None:
            self.camera.check_is(serial, self.path, measured_by)


class CalibrationDocument(BaseModel):
    """The keys of every calibration file; the description of a field is the advice after a bad value.

    A key this version does not know is refused: it may change what the others mean.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    camera: CameraIdentity | None = optional('give {vendor: ..., model: ..., serial: "..."}, each in quotes')
    date: Annotated[datetime, Strict()] | None = optional("give date and time, such as 2026-11-21 12:00:00")
    tool: Text | None = optional("give name and version in quotes")
    findings: tuple[Finding, ...] | None = optional("keep it as it was written")

    def measured(self, path: Path) -> dict[str, Any]:
        """What it says for a `MeasuredFile`, read from a path."""
        return {
            "camera": self.camera,
            "date": self.date,
            "tool": self.tool,
            "findings": self.findings or (),
            "path": path,
        }


def read_document(model: type[D], path: Path, file_format: str) -> D:
    """The content of a calibration file. Raises ConfigurationError naming the file, the key and what to do."""
    content = load_mapping(path, f"begin with 'format: {file_format}'")
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {_error_sentence(model, error.errors()[0], content)}") from None


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write a calibration file without the keys that say nothing (None, empty).

    Raises ConfigurationError when the file cannot be written; a former one then stays as it was.
    """
    said = {key: value for key, value in document.items() if value not in (None, {}, [])}
    text = yaml.safe_dump(said, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    with written(path):
        replace_file(path, text.encode())


def _error_sentence(model: type[BaseModel], error: ErrorDetails, content: Mapping[Any, Any]) -> str:
    """What is wrong with a file's `content`, and what to do: the description of the field of `model` says that."""
    if not error["loc"]:  # keys that do not fit each other
        return error["msg"].removeprefix("Value error, ")
    key, *places = error["loc"]
    if error["type"] in ("extra_forbidden", "invalid_key") and not places:
        return f"unknown key {quoted(key)}: remove it, or update this program"
    if error["type"] == "missing" and not places:
        return f"the key {quoted(key)} is missing: add it"
    value = content[key]
    if places and isinstance(places[0], int) and isinstance(value, list) and places[0] < len(value):
        key, value = f"{key}[{places[0]}]", value[places[0]]
    return f"{key} is {quoted(value)}: {model.model_fields[str(error['loc'][0])].description}"
