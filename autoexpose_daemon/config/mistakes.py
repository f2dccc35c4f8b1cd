"""What is wrong with data from outside, one sentence for each mistake that pydantic finds."""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from documents.text import shortened


def mistakes(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """A sentence for each thing that is wrong with data for a model, beginning with its key."""
    return [_complaint(each, model) for each in error.errors()]


def _complaint(error: ErrorDetails, model: type[BaseModel]) -> str:
    key = ".".join(shortened(str(part)) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        *parents, last = [str(part) for part in error["loc"]]
        known = _keys_of(parents, model)
        near = difflib.get_close_matches(last, known, n=1)
        hint = f"did you mean {'.'.join([*parents, near[0]])}?" if near else f"known: {', '.join(known)}"
        return f"{key}: unknown key; {hint}"
    if error["type"] == "model_type" and key:
        return f"{key}: is {'empty' if error['input'] is None else 'no section'}: give keys below it, or remove it"
    if error["type"] == "missing":
        return f"{key}: is missing"
    message = error["msg"].removeprefix("Value error, ")
    return f"{key + ': ' if key else ''}{message[0].lower()}{message[1:]}"


def _keys_of(parents: list[str], model: type[BaseModel]) -> list[str]:
    """The known keys below a path of keys, taken from the models themselves."""
    for parent in parents:
        if parent.isdecimal():  # a place in a list
            continue
        annotation: Any = model.model_fields[parent].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return list(model.model_fields)
