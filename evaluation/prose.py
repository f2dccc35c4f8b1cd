"""Reports in Markdown: prose, which stands in text files beside the modules that report, and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path


def text_beside(module_file: str, name: str | None = None, **values: object) -> str:
    """The text in `name`, or in the file named as the module, with `values` in the places in braces."""
    module = Path(module_file)
    file = module.with_name(name) if name else module.with_suffix(".txt")
    return file.read_text(encoding="utf-8").format(**values).strip()


def markdown_table(heads: Sequence[str], rows: Iterable[Iterable[str]], texts: int = 1) -> str:
    """A table in Markdown: the first `texts` columns to the left, numbers to the right."""
    lines = "|" + "---|" * texts + "---:|" * (len(heads) - texts)
    return "\n".join([_row(heads), lines, *map(_row, rows)])


def _row(cells: Iterable[str]) -> str:
    """A row of a table in Markdown."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
