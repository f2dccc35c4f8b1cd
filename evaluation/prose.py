"""Reports in Markdown: prose, which stands in text files beside the modules that report, and tables."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def text_beside(module_file: str, name: str | None = None, **values: object) -> str:
    """The text in `name`, or in the file named as the module, with `values` in the places in braces."""
    module = Path(module_file)
    file = module.with_name(name) if name else module.with_suffix(".txt")
    return file.read_text(encoding="utf-8").format(**values).strip()


def table_row(cells: Iterable[str]) -> str:
    """A row of a table in Markdown."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
