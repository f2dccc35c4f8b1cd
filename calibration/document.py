"""What calibration files have in common: they are read and written here, and each finding is one sentence."""

from __future__ import annotations

from collections.abc import Mapping
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
    """A reason not to believe a calibration.

    Attributes
    ----------
    severity
        "refused": no result can be drawn from this; "warned": there is a result, with less trust.
    reason
        A short name that stays the same between versions, such as "light_drift".
    text
        One sentence: what was seen, in numbers, and what to do.
    """

    severity: Literal["refused", "warned"]
    reason: str
    text: str


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


class CalibrationDocument(BaseModel):
    """The keys of every calibration file; the description of a field is the advice after a bad value.

    A key this version does not know is refused: it may change what the others mean.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    camera: CameraIdentity | None = optional('give {vendor: ..., model: ..., serial: "..."}, each in quotes')
    date: Annotated[datetime, Strict()] | None = optional("give date and time, such as 2026-11-21 12:00:00")
    tool: Text | None = optional("give name and version in quotes")
    findings: tuple[Finding, ...] | None = optional("keep it as it was written")


def read_document(model: type[D], path: Path, file_format: str) -> D:
    """The content of a calibration file.

    Raises
    ------
    ConfigurationError
        Naming the file, the key and what to do.
    """
    content = load_mapping(path, f"begin with 'format: {file_format}'")
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {_error_sentence(model, error.errors()[0], content)}") from None


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write a calibration file without the keys that say nothing (None, empty).

    Raises
    ------
    ConfigurationError
        When the file cannot be written; a former one then stays as it was.
    """
    said = {key: value for key, value in document.items() if value not in (None, {}, [])}
    text = yaml.safe_dump(said, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    try:
        replace_file(path, text.encode())
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written ({error.strerror}): choose another place") from error


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
