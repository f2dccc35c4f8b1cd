"""What a camera makes of light, as the daemon sends it to clients in JSON: its response function and its vignetting."""

from __future__ import annotations

import json
from typing import Any, Final

import numpy as np

from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

LARGEST_RESPONSE_BYTES: Final = 1 << 16
"""The 256 numbers of a response function take 6 KB, the largest grid of a vignetting up to 53 KB."""


def response_to_json(response: ResponseFunction, vignetting: Vignetting | None = None) -> str:
    """The message about a camera; `vignetting` None: it is not known."""
    content: dict[str, Any] = {
        "log2_exposure": response.log2_exposure.tolist(),
        "black_level": response.black_level,
        "saturation": response.saturation,
    }
    if vignetting is not None:
        light = vignetting.as_plain()
        if "grid" in light:
            # To six digits: with all of them, a large grid would be too long to be read.
            light["grid"] = [[float(f"{at:.6g}") for at in row] for row in light["grid"]]
        content["vignetting"] = light
    return json.dumps(content)


def response_from_json(text: str | bytes) -> ResponseFunction | None:
    """The response function in a message; None if the message is damaged."""
    try:
        content = _content(text)
        curve = np.array(_numbers(content["log2_exposure"]), np.float64)
        return ResponseFunction(curve, _whole(content["black_level"]), _whole(content["saturation"]))
    except _DAMAGED:
        return None


def vignetting_from_json(text: str | bytes) -> Vignetting | None:
    """The vignetting in a message; None if there is none, or the message is damaged."""
    try:
        light = _content(text)["vignetting"]
        size = _whole(light["width"]), _whole(light["height"])
        if "grid" in light:
            return Vignetting(*size, _middle(size), (), tuple(_numbers(row) for row in light["grid"]))
        x, y = _numbers(light["centre_px"])
        return Vignetting(*size, (x, y), _numbers(light["coefficients"]))
    except _DAMAGED:
        return None


_DAMAGED = (ValueError, TypeError, KeyError, OverflowError, RecursionError, ConfigurationError)


def _content(text: str | bytes) -> Any:
    if len(text) > LARGEST_RESPONSE_BYTES:
        raise ValueError("longer than any daemon's")
    return json.loads(text)


def _numbers(values: Any) -> tuple[float, ...]:
    if not all(type(value) in (int, float) for value in values):
        raise ValueError("not all are numbers")
    return tuple(map(float, values))


def _whole(value: Any) -> int:
    if type(value) is not int:
        raise ValueError("not a whole number")
    return value


def _middle(size: tuple[int, int]) -> tuple[float, float]:
    return (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
