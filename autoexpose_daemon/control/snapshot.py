"""State as plain data and back, so that a replay can start in the middle of a run.

What a `Stateful` class annotates is its state, and what is `Built` is not: it follows from how the object was built, or
no later step reads it. Attributes without an annotation are made with the object and never replaced. `take` turns the
state into plain data; `restore` puts it into an object that was built the same way. The annotation says what an
attribute may hold, so data from outside cannot bring in anything else.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Plain = None | bool | int | float | str | NDArray[Any] | list["Plain"] | dict[str, "Plain"]
"""Numbers, strings, arrays, and lists and dictionaries of them."""


ARRAY_TYPES = ("uint8", "int16", "float32", "float64")
"""Of what arrays may be: recordings hold no others."""

T = TypeVar("T")
_BUILT = "built"
Built = Annotated[T, _BUILT]
"""The annotation of an attribute that is no state."""


class Stateful:
    """An object that remembers something from step to step: all that its class annotates."""

    __slots__ = ()


def take(holder: Stateful) -> dict[str, Plain]:
    """A copy of the state of an object, by attribute, without leading underscores."""
    kind: type = type(holder)
    return {name.lstrip("_"): _state_or_plain(getattr(holder, name)) for name in state_names(kind)}


def restore(holder: Stateful, state: Plain) -> None:
    """Give an object the state that `take` copied from one built the same way.

    Raises ValueError, which names what does not fit; the object may then be half restored.
    """
    kind: type = type(holder)
    hints, names = _hints(kind), state_names(kind)
    values = _members(state, [name.lstrip("_") for name in names], kind.__name__)
    for name, value in zip(names, values, strict=True):
        current = getattr(holder, name)
        if isinstance(current, Stateful):
            restore(current, value)
        elif _holds_stateful(current):
            for key, member in zip(current, _members(value, list(current), name), strict=True):
                restore(current[key], member)
        elif isinstance(current, deque):  # its length follows from how it was built
            current.clear()
            current.extend(parse(value, hints[name]))
        else:
            setattr(holder, name, parse(value, hints[name]))


@cache
def state_names(kind: type) -> tuple[str, ...]:
    """The attributes that are the state of a `Stateful` class."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(
        name
        for name, hint in hints.items()
        if get_origin(hint) is not ClassVar and _BUILT not in getattr(hint, "__metadata__", ())
    )


def plain(value: object) -> Plain:
    """A copy of a value as plain data; dataclasses become dictionaries, tuples and deques lists."""
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return float(value)  # numpy's float64 is also a float
        case np.ndarray():
            if value.dtype.name not in ARRAY_TYPES:
                raise TypeError(f"an array of {value.dtype} is no state: use one of {', '.join(ARRAY_TYPES)}")
            return value.copy()
        case list() | tuple() | deque():
            return [plain(item) for item in value]
        case Mapping():
            return {str(key): plain(item) for key, item in value.items()}
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    raise TypeError(f"{type(value).__name__} cannot be kept as plain data")


def parse(data: Plain, hint: Any) -> Any:
    """The value of an annotated type from which `plain` made this data.

    Raises ValueError for data that is not of this type.
    """
    if get_origin(hint) in (Union, UnionType):
        if data is None and NoneType in get_args(hint):
            return None
        (hint,) = (argument for argument in get_args(hint) if argument is not NoneType)
    if is_dataclass(hint):
        assert isinstance(hint, type)
        hints = _hints(hint)
        values = _members(data, list(hints), hint.__name__)
        return hint(**{name: parse(value, hints[name]) for name, value in zip(hints, values, strict=True)})
    if isinstance(data, list | dict):
        return _collection(data, hint)
    if get_origin(hint) is Literal:
        fits = any(type(data) is type(choice) and data == choice for choice in get_args(hint))
    elif get_origin(hint) in (np.ndarray, NDArray):  # the second from numpy 2.5 on, where it is an alias of its own
        kinds = get_args(hint) if get_origin(hint) is NDArray else get_args(get_args(hint)[1])
        fits = isinstance(data, np.ndarray) and kinds == (data.dtype.type,)
    elif hint is float and type(data) is int:
        return float(data)
    else:
        fits = type(data) is hint
    if not fits:
        raise ValueError(f"{_shown(data)} is no {getattr(hint, '__name__', hint)}")
    return data.copy() if isinstance(data, np.ndarray) else data


def _collection(data: list[Plain] | dict[str, Plain], hint: Any) -> Any:
    kind, arguments = get_origin(hint), get_args(hint)
    if isinstance(data, dict) and kind is dict:
        return {parse(key, arguments[0]): parse(item, arguments[1]) for key, item in data.items()}
    if isinstance(data, list) and kind in (list, deque):
        return [parse(item, arguments[0]) for item in data]
    if isinstance(data, list) and kind is tuple:
        kinds = arguments[:1] * len(data) if arguments[-1] is Ellipsis else arguments
        return tuple(parse(item, argument) for item, argument in zip(data, kinds, strict=True))
    raise ValueError(f"a {type(data).__name__} is no {hint}")


def _state_or_plain(value: Any) -> Plain:
    if _holds_stateful(value):
        return {key: take(holder) for key, holder in value.items()}
    return take(value) if isinstance(value, Stateful) else plain(value)


def _holds_stateful(value: Any) -> bool:
    return isinstance(value, dict) and any(isinstance(holder, Stateful) for holder in value.values())


@cache
def _hints(kind: type) -> dict[str, Any]:
    """The annotations of the attributes of a class, resolved."""
    return {name: hint for name, hint in get_type_hints(kind).items() if get_origin(hint) is not ClassVar}


def _members(data: Plain, names: list[str], owner: str) -> list[Plain]:
    if not isinstance(data, dict) or set(data) != set(names):
        found = ", ".join(sorted(data)) if isinstance(data, dict) else _shown(data)
        raise ValueError(f"{owner} needs {', '.join(names) or 'nothing'}, not {found or 'nothing'}")
    return [data[name] for name in names]


def _shown(data: Plain) -> str:
    if isinstance(data, float) and not math.isfinite(data):
        return str(data)
    return f"{data!r:.40}" if isinstance(data, bool | int | float | str) else type(data).__name__
