"""Files of calibration, read and written; what is wrong with one is said in a sentence."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from drivers.config.strict_yaml import load_mapping
from drivers.errors import ConfigurationError

D = TypeVar("D", bound=BaseModel)


def read_document(model: type[D], path: Path, file_format: str) -> D:
    """The content of a file of calibration.

    Raises
    ------
    ConfigurationError
        Naming the file, the key and what to do.
    """
    content = load_mapping(path, f"begin with 'format: {file_format}'")
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {_complaint(model, error.errors()[0], content)}") from None


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write a file of calibration without the keys that say nothing (None, empty).

    Raises
    ------
    ConfigurationError
        When the file cannot be written.
    """
    said = {key: value for key, value in document.items() if value not in (None, {}, [])}
    text = yaml.safe_dump(said, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written ({error.strerror}): choose another place") from error


def _complaint(model: type[BaseModel], error: ErrorDetails, content: Mapping[Any, Any]) -> str:
    """What is wrong with a file's `content`, and what to do: the description of the field of `model` says that."""
    if not error["loc"]:  # keys that do not fit each other
        return error["msg"].removeprefix("Value error, ")
    key, *places = error["loc"]
    if error["type"] in ("extra_forbidden", "invalid_key") and not places:
        return f"unknown key {key!r}: remove it, or update this program"
    if error["type"] == "missing" and not places:
        return f"the key {key!r} is missing: add it"
    value = content[key]
    if places and isinstance(places[0], int) and isinstance(value, list) and places[0] < len(value):
        key, value = f"{key}[{places[0]}]", value[places[0]]
    return f"{key} is {reprlib.repr(value)}: {model.model_fields[str(error['loc'][0])].description}"
