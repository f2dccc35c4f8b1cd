"""Lists of images and their exposure times, as people write them.

Each line holds an image's name (relative to the list) and its exposure time, or only a time; times without names
belong to the images next to the list, in the order of their names. A time is in seconds unless `us`, `ms` or `s`
follows, and may be a fraction (`1/30`). Empty lines, and everything after `#`, are ignored.

With commas, semicolons or tabs between them there may be more columns if the first line names them: the time is in the
one whose name contains `exposure`, `shutter` or `time`, with its unit if it is not seconds (`exposure_us`,
`time (ms)`); the image in one whose name contains `file`, `image`, `name` or `path`.

The TUM mono data set's `times.txt` has three numbers per line: that of the image (`images/00012.jpg`), a time stamp,
and the exposure time in milliseconds.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from documents.files import read_regular
from documents.text import quoted
from imaging.errors import ConfigurationError

_MOST_BYTES = 1 << 20
_SECONDS_PER_UNIT = {"": 1.0, "ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_SEPARATOR = re.compile(r"\s*[,;\t]\s*")
_TIME = re.compile(r"(.*?)\s*(ns|us|ms|s|)", re.IGNORECASE)
_TIME_COLUMNS = re.compile("exposure", re.IGNORECASE), re.compile("shutter|time(?!_?stamp)", re.IGNORECASE)
_IMAGE_COLUMN = re.compile("file|image|name|path", re.IGNORECASE)
_UNIT_OF_COLUMN = re.compile(r"[\W_](ns|us|ms|s)\W*$", re.IGNORECASE)
_TUM_IMAGES = ("images/{}.jpg", "images/{}.png", "{}.jpg", "{}.png")


class _Row(NamedTuple):
    number: int
    cells: list[str]


class _Columns(NamedTuple):
    """Places of the image's name (None: there is none) and of the time, and the unit of the time."""

    name: int | None
    time: int
    unit: str


def read_list(path: Path, beside: Callable[[Path], list[Path]]) -> list[tuple[Path, float]]:
    """The images of a list, and their exposure times in seconds; `beside` gives the images of a folder, by name.

    Raises
    ------
    ConfigurationError
        Naming the file and the line at fault.
    """
    rows = _rows(path)
    if all(len(row.cells) == 3 and all(_number(cell) is not None for cell in row.cells) for row in rows):
        return _of_tum(path, rows)
    columns = _columns(rows[0].cells)
    rows = rows if columns is None else rows[1:]
    if not rows:
        raise ConfigurationError(f"{path}: has no line after the first: write one image and its time per line")
    named = any(len(row.cells) > 1 for row in rows) if columns is None else columns.name is not None
    seconds: list[float] = []
    images: list[Path] = []
    for number, cells in rows:
        where = f"{path}: line {number}"
        column = columns or _Columns(0 if len(cells) > 1 else None, len(cells) - 1, "")
        if max(column.name or 0, column.time) >= len(cells):
            raise ConfigurationError(f"{where}: has {len(cells)} columns, fewer than the first line: complete it")
        seconds.append(_seconds(cells[column.time], where, column.unit))
        if named:
            images.append(_image(path.parent, None if column.name is None else cells[column.name], images, where))
    return list(zip(images if named else _all_of(beside(path.parent), path, seconds), seconds, strict=True))


def _image(folder: Path, name: str | None, others: list[Path], where: str) -> Path:
    """The image that a line names."""
    if name is None:
        raise ConfigurationError(f"{where}: names no image, but other lines do: add its name")
    image = folder / name
    if not os.path.isfile(image):  # noqa: PTH113 - Path.is_file raises for names that are too long
        raise ConfigurationError(f"{where}: there is no image {image}: correct its name")
    if image in others:
        raise ConfigurationError(f"{where}: names {name} again: leave one line for each image")
    return image


def _all_of(images: list[Path], path: Path, seconds: list[float]) -> list[Path]:
    if len(images) != len(seconds):
        raise ConfigurationError(
            f"{path}: has {len(seconds)} times, but {len(images)} images lie next to it: "
            "write one time for each, or name the images"
        )
    return images


def _rows(path: Path) -> list[_Row]:
    try:
        lines = read_regular(path, _MOST_BYTES).decode("utf-8-sig").splitlines()
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}): check its name and access") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: is not text: name a folder of images, or a list of them") from error
    rows = [_Row(number, _cells(line.partition("#")[0].strip())) for number, line in enumerate(lines, 1)]
    rows = [row for row in rows if any(row.cells)]
    if not rows:
        raise ConfigurationError(f"{path}: is empty: write one image and its time in seconds per line")
    return rows


def _cells(line: str) -> list[str]:
    """Columns; without separators two at most, since names have blanks, or three numbers."""
    if _SEPARATOR.search(line):
        return [cell.strip("\"' ") for cell in _SEPARATOR.split(line)]
    words = line.split()
    if len(words) == 3 and all(_number(word) is not None for word in words):
        return words
    return [" ".join(words[:-1]), words[-1]] if len(words) > 1 else words


def _columns(cells: list[str]) -> _Columns | None:
    """What a first line says of the columns; None if it is not about them."""
    if any(_number(cell) is not None for cell in cells):
        return None
    for pattern in _TIME_COLUMNS:
        for place, cell in enumerate(cells):
            if pattern.search(cell):
                image = next((i for i, other in enumerate(cells) if i != place and _IMAGE_COLUMN.search(other)), None)
                unit = _UNIT_OF_COLUMN.search(cell)
                return _Columns(image, place, unit[1].lower() if unit else "")
    return None


def _of_tum(path: Path, rows: list[_Row]) -> list[tuple[Path, float]]:
    files = []
    for number, (image, _, time) in rows:
        where = f"{path}: line {number}"
        found = [path.parent / name.format(image) for name in _TUM_IMAGES]
        there = next((name for name in found if name.is_file()), None)
        if there is None:
            raise ConfigurationError(f"{where}: there is no image {found[0]}: unpack images.zip next to the list")
        files.append((there, _seconds(time, where, "ms")))
    return files


def _number(word: str) -> float | None:
    """A number or fraction without a unit."""
    over, _, under = word.partition("/")
    try:
        return float(over) / float(under) if under else float(over)
    except (ValueError, ZeroDivisionError):
        return None


def _seconds(word: str, where: str, unit: str) -> float:
    split = _TIME.fullmatch(word)
    value = None if split is None else _number(split[1])
    if split is None or value is None or not 0 < value < math.inf:
        raise ConfigurationError(
            f"{where}: {quoted(word)} is not an exposure time: give seconds above 0, such as 0.0333 or 1/30"
        )
    return value * _SECONDS_PER_UNIT[split[2].lower() or unit]
