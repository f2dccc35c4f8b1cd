"""Text from outside, made safe for terminals and logs."""

from __future__ import annotations

import reprlib

LONGEST_QUOTE = 60
"""Characters of what somebody wrote that an error shows: enough to find it."""


def readable(text: str, keep: str = "") -> str:
    """The text with everything but printable characters, and those of `keep`, escaped: `\\x1b` for ESC."""
    return "".join(char if char.isprintable() or char in keep else ascii(char)[1:-1] for char in text)


def shortened(text: str, most: int = LONGEST_QUOTE) -> str:
    """The text without its middle, if it is longer than `most` characters."""
    half = (most - 3) // 2
    return text if len(text) <= most else f"{text[:half]}...{text[-half:]}"


def quoted(value: object) -> str:
    """A value as an error quotes it: as Python writes it, of at most `LONGEST_QUOTE` characters."""
    return shortened(_QUOTES.repr(value))


class _Quotes(reprlib.Repr):
    """Python refuses to write integers of more than 4300 digits."""

    def repr_int(self, value: int, level: int) -> str:
        return hex(value) if value.bit_length() > LONGEST_QUOTE else super().repr_int(value, level)


_QUOTES = _Quotes()
_QUOTES.maxlevel = 3
_QUOTES.maxstring = _QUOTES.maxother = LONGEST_QUOTE
