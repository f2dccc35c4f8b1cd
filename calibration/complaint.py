"""One sentence about what is wrong with a file of calibration."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel
from pydantic_core import ErrorDetails


def complaint(model: type[BaseModel], error: ErrorDetails, content: Mapping[Any, Any]) -> str:
    """What is wrong with a file's `content`, and what to do: the description of the field of `model` says that."""
    key, *places = error["loc"]
    if error["type"] in ("extra_forbidden", "invalid_key") and not places:
        return f"unknown key {key!r}: remove it, or update this program"
    if error["type"] == "missing" and not places:
        return f"the key {key!r} is missing: add it"
    value = content[key]
    if places and isinstance(places[0], int) and isinstance(value, list):
        key, value = f"{key}[{places[0]}]", value[places[0]]
    return f"{key} is {reprlib.repr(value)}: {model.model_fields[str(error['loc'][0])].description}"
