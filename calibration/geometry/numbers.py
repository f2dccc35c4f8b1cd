"""Numbers of a calibration file, however they are written: lists, matrices of OpenCV and ROS, and text."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from documents.text import quoted
from imaging.errors import ConfigurationError

LARGEST = 1e9
LARGEST_PIXELS = 65_536
_ROUNDED = 1e-3
"""Files may be written with few digits."""
_DEEPEST = 3


def mapping(content: Mapping[Any, Any], key: str) -> Mapping[Any, Any]:
    """The section under a key; raises ConfigurationError."""
    value = required(content, key)
    if not isinstance(value, Mapping):
        raise ConfigurationError(f"{key} is {quoted(value)}: give keys and values")
    return value


def required(content: Mapping[Any, Any], key: str, named: str = "") -> Any:
    """The value under a key that must be there; raises ConfigurationError."""
    if key not in content:
        raise ConfigurationError(f"the key {named or key} is missing: add it")
    return content[key]


def numbers(value: Any, key: str, *counts: int) -> tuple[float, ...]:
    """Finite numbers, as many as one of `counts`; raises ConfigurationError.

    They may be a list, a list of rows, the `data` of a matrix, or text. C++ programs write `1e-05`, which YAML 1.1
    takes for text.
    """
    found: list[float] = []
    for each in _leaves(value, key):
        try:
            number = math.nan if isinstance(each, bool) else float(each)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise ConfigurationError(f"{key} holds {quoted(each)}: give finite numbers only")
        if abs(number) > LARGEST:
            raise ConfigurationError(f"{key} holds {quoted(each)}, which nothing in a calibration is: calibrate again")
        found.append(number)
    if counts and len(found) not in counts:
        raise ConfigurationError(
            f"{key} is {quoted(value)}: give a list of {' or '.join(map(str, counts))} numbers, not {len(found)}"
        )
    return tuple(found)


def pixels(value: Any, key: str) -> int:
    """A size in pixels; raises ConfigurationError."""
    try:
        (number,) = numbers(value if isinstance(value, str) else [value], key)
    except (ValueError, ConfigurationError):
        number = 0.0
    if not number.is_integer() or not 0 < number <= LARGEST_PIXELS:
        raise ConfigurationError(f"{key} is {quoted(value)}: give a whole number of pixels")
    return int(number)


def size_of(value: Any, key: str) -> tuple[int, int]:
    """Width and height; raises ConfigurationError."""
    found = numbers(value, key)
    if len(found) != 2:
        raise ConfigurationError(f"{key} is {quoted(value)}: give width and height")
    return pixels(found[0], key), pixels(found[1], key)


def pose_of(value: Any, key: str) -> NDArray[np.float64]:
    """Rotation and translation, shape (4, 4), of three or four rows; raises ConfigurationError."""
    rows = numbers(value, key, 12, 16)
    pose = np.array([*rows, 0.0, 0.0, 0.0, 1.0][:16]).reshape(4, 4)
    if not is_rotation(pose[:3, :3]) or pose[3].tolist() != [0, 0, 0, 1]:
        raise ConfigurationError(f"{key} is no rotation and translation: calibrate again")
    return pose


def inverse_of(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose the other way round."""
    return np.asarray(np.linalg.inv(pose), np.float64)


def is_rotation(r: NDArray[np.float64]) -> bool:
    """Whether a matrix of shape (3, 3) is a rotation, apart from rounding."""
    return bool(np.abs(r).max() < 2 and np.abs(r @ r.T - np.eye(3)).max() <= _ROUNDED and np.linalg.det(r) > 0)


def _leaves(value: Any, key: str, depth: int = 0) -> Iterator[Any]:
    if isinstance(value, Mapping):
        yield from _leaves(required(value, "data", f"{key}.data"), f"{key}.data", depth + 1)
    elif isinstance(value, str):
        yield from re.sub(r"[\[\],;]", " ", value).split()
    elif isinstance(value, list) and depth < _DEEPEST:
        for part in value:
            yield from _leaves(part, key, depth + 1) if isinstance(part, list) else (part,)
    else:
        raise ConfigurationError(f"{key} is {quoted(value)}: give a list of numbers")
