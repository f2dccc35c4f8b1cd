"""Text from outside, made safe for terminals and logs."""

from __future__ import annotations


def readable(text: str, keep: str = "") -> str:
    """The text with everything but printable characters, and those of `keep`, escaped: `\\x1b` for ESC."""
    return "".join(char if char.isprintable() or char in keep else ascii(char)[1:-1] for char in text)
