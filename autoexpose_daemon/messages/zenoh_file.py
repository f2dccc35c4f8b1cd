"""Configuration files of zenoh that a configuration or a command names."""

from __future__ import annotations

import re
from pathlib import Path

from documents.files import read_regular
from documents.text import readable
from imaging.errors import ConfigurationError

_MOST_BYTES = 1 << 20
_DEEPEST = 100  # zenoh's own has 6 levels; at some 50,000 its parser overflows the stack
_PLACE = re.compile(r"--> (\d+):(\d+).*= (.*)", re.DOTALL)
_MESSAGE = re.compile(r'msg: "((?:[^"\\]|\\.)*)')
_LONGEST_REASON = 160


def check_zenoh_file(file: Path) -> None:
    """Raise ConfigurationError for a file that zenoh cannot use: without zenoh, only for one that cannot be read."""
    try:
        content = read_regular(file, _MOST_BYTES)  # given a pipe, zenoh itself would wait for a writer
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigurationError(f"{file} cannot be read ({reason}): name a zenoh configuration file") from error
    if _depth(content) > _DEEPEST:
        raise ConfigurationError(f"{file} is not a configuration of zenoh: it nests more than {_DEEPEST} levels")
    try:
        import zenoh  # noqa: PLC0415  part of an extra
    except ModuleNotFoundError:
        return  # whoever needs it says so
    try:
        zenoh.Config.from_file(file)
    except zenoh.ZError as error:
        raise ConfigurationError(f"{file} is not a configuration of zenoh: {_reason(str(error))}") from error


def _depth(content: bytes) -> int:
    depth = deepest = 0
    for byte in content:
        depth += (byte in b"[{") - (byte in b"]}")
        deepest = max(deepest, depth)
    return deepest


def _reason(text: str) -> str:
    """What zenoh says, in a line and without the places in its sources."""
    text = text.split(" at /", maxsplit=1)[0]
    if place := _PLACE.search(text):
        text = f"line {place[1]}, column {place[2]}: {place[3]}"
    elif message := _MESSAGE.search(text):
        text = message[1]
    text = readable(" ".join(text.split()))
    return text if len(text) <= _LONGEST_REASON else f"{text[:_LONGEST_REASON]} ..."
