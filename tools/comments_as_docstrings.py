"""For the reference: a field's comment, above it or behind it, is what is said of it. An extension of griffe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from griffe import Attribute, Docstring, Extension


class CommentsAsDocstrings(Extension):
    """Gives each attribute without a docstring that of its comment."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        """Look at the lines of an attribute that has just been found."""
        if attr.docstring is None and attr.lineno is not None and isinstance(attr.filepath, Path):
            text = comment(attr.lines_collection[attr.filepath], attr.lineno)
            attr.docstring = Docstring(text, parent=attr) if text else None


def comment(lines: list[str], number: int) -> str:
    """The comment that belongs to a line, counted from 1; empty: there is none."""
    _, _, behind = lines[number - 1].partition("  # ")
    above: list[str] = []
    while (line := lines[number - 2 - len(above)].strip()).startswith("# "):
        above.insert(0, line[2:])
    return behind or " ".join(above)
