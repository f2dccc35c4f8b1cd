"""Plain data of control as JSON and back, bit for bit; arrays as dtype, shape and base64."""

from __future__ import annotations

import base64
import binascii
import json
from typing import Any

import numpy as np

from autoexpose_daemon.control.snapshot import Plain

_DTYPES = ("uint8", "int16", "float32", "float64")
_KEYS = {"dtype", "shape", "base64"}


def to_json(data: Plain) -> str:
    """JSON on one line; floats in the shortest form that reads back the same, as `json` writes them."""
    return json.dumps(data, default=_array_to_json, separators=(",", ":"))


def from_json(text: str) -> Any:
    """What `to_json` was given.

    Raises
    ------
    ValueError
        For text that `to_json` would not write.
    """
    try:
        return json.loads(text, object_hook=_array_from_json)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _array_to_json(array: object) -> dict[str, Any]:
    if not isinstance(array, np.ndarray) or array.dtype.name not in _DTYPES:
        raise TypeError(f"{type(array).__name__} is not an array of {', '.join(_DTYPES)}")
    little_endian = array.astype(array.dtype.newbyteorder("<"), copy=False)
    encoded = base64.b64encode(little_endian.tobytes()).decode()
    return {"dtype": array.dtype.name, "shape": list(array.shape), "base64": encoded}


def _array_from_json(members: dict[str, Any]) -> Any:
    if set(members) != _KEYS:
        return members
    try:
        if members["dtype"] not in _DTYPES:
            raise ValueError(f"an array of {members['dtype']}")
        content = base64.b64decode(members["base64"], validate=True)
        dtype = np.dtype(members["dtype"])
        return np.frombuffer(content, dtype.newbyteorder("<")).astype(dtype).reshape(members["shape"])
    except (TypeError, OverflowError, binascii.Error) as error:
        raise ValueError(f"a damaged array: {error}") from None
