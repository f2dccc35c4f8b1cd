"""What a target of fuzzing is: a parser of bytes from outside, and what it may do with them."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Target:
    """One parser.

    Attributes
    ----------
    parse
        Parses the bytes; what it returns does not matter.
    refuses
        The errors by which it may refuse them, each in words.
    seeds
        Makes valid inputs, by our own encoders.
    """

    name: str
    parse: Callable[[bytes], object]
    refuses: tuple[type[Exception], ...]
    seeds: Callable[[], Iterable[bytes]]

    def check(self, data: bytes) -> None:
        """Parse `data`; raises whatever the parser should not."""
        try:
            self.parse(data)
        except self.refuses as error:
            assert str(error), "refused without a word"
            str(error).encode()  # it can be printed


def framed(*parts: bytes) -> bytes:
    """Several messages as one input: each after its length in two bytes."""
    return b"".join(struct.pack(">H", len(part)) + part for part in parts)


def unframed(data: bytes) -> Iterator[bytes]:
    """The messages of any input; the last one may be cut."""
    while data:
        length = int.from_bytes(data[:2], "big")
        yield data[2 : 2 + length]
        data = data[2 + length :]


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="fuzz-")


def in_file(data: bytes, name: str) -> Path:
    """A file of this name that holds `data`; what was there before is gone."""
    path = Path(_folder().name) / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path
