"""A sweep from image files, whose exposure times stand in EXIF, in their names, or in a list."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.sweep import Shot, Sweep
from documents.files import SIGNATURE, is_whole_png, open_regular, read_regular
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.pixels import Pixels

_MOST_BYTES = 1 << 20
_SECONDS_PER_UNIT = {"": 1.0, "ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_SEPARATOR = re.compile(r"\s*[,;\t]\s*")
_TIME = re.compile(r"(.*?)\s*(ns|us|ms|s|)", re.IGNORECASE)
_TIME_COLUMNS = re.compile("exposure", re.IGNORECASE), re.compile("shutter|time(?!_?stamp)", re.IGNORECASE)
_IMAGE_COLUMN = re.compile("file|image|name|path", re.IGNORECASE)
_UNIT_OF_COLUMN = re.compile(r"[\W_](ns|us|ms|s)\W*$", re.IGNORECASE)


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

    Raises ConfigurationError naming the file and the line at fault.
    """
    rows = _rows(path)
    if all(len(row.cells) == 3 and all(_number(cell) is not None for cell in row.cells) for row in rows):
        return read_tum_times(path)
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


def read_tum_times(path: Path) -> list[tuple[Path, float]]:
    """The images of `times.txt` of the TUM mono data set, and their exposure times in seconds.

    Its lines are number, time and exposure in ms. Raises ConfigurationError naming the file and the line at fault.
    """
    folders = [folder for folder in (path.parent, path.parent / "images") if folder.is_dir()]
    images = {image.stem: image for folder in folders for image in image_paths(folder)}
    files = []
    for number, cells in _rows(path):
        where = f"{path}: line {number}"
        if len(cells) < 3:
            raise ConfigurationError(f"{where}: has no exposure time: give number, time, exposure in ms")
        if cells[0] not in images:
            image = path.parent / "images" / cells[0]
            raise ConfigurationError(f"{where}: there is no image {image}: unpack images.zip next to the list")
        files.append((images[cells[0]], _seconds(cells[2], where, "ms")))
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


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm")
_EXIF_IFD, _EXPOSURE_TIME, _F_NUMBER, _SENSITIVITY = 0x8769, 0x829A, 0x829D, 0x8827
_TIME_IN_NAME = re.compile(r"(?<![\d.])(\d+(?:\.\d+)?)(us|ms|s)(?![0-9A-Za-z])")
_TUM_LIST = "times.txt"


@dataclass(frozen=True, slots=True)
class TimedFile:
    """An image file and its exposure time in seconds."""

    path: Path
    exposure_s: float


def timed_files(source: Path) -> list[TimedFile]:
    """The images of a folder (in the order of their names, timed by EXIF or else by name), or of a list.

    A folder that holds a `times.txt`, as those of the TUM mono data set, is timed by that list. Raises
    ConfigurationError naming the file and the line at fault.
    """
    if not source.is_dir():
        return [TimedFile(*entry) for entry in read_list(source, image_paths)]
    if (source / _TUM_LIST).is_file():
        return timed_files(source / _TUM_LIST)
    return _in_folder(source)


def _in_folder(folder: Path) -> list[TimedFile]:
    paths = image_paths(folder)
    if not paths:
        raise ConfigurationError(f"{folder}: holds no images ({', '.join(IMAGE_SUFFIXES)}): name another folder")
    by_exif = [_exif_seconds(path) for path in paths]
    seconds = by_exif if any(by_exif) else [seconds_in_name(path) for path in paths]
    for path, value in zip(paths, seconds, strict=True):
        if value is None:
            raise ConfigurationError(
                f"{path}: has no exposure time in EXIF or in its name (as in img_5000us.png): "
                "give a list, one image and its time in seconds per line"
            )
    if any(by_exif):
        _require_one(paths, _F_NUMBER, "f-number")
        _require_one(paths, _SENSITIVITY, "ISO sensitivity")
    return [TimedFile(path, value) for path, value in zip(paths, seconds, strict=True) if value is not None]


def image_paths(folder: Path) -> list[Path]:
    """The image files of a folder, by name; raises ConfigurationError."""
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    except OSError as error:
        raise ConfigurationError(f"{folder}: cannot be read ({error.strerror}): check its access") from error


def seconds_in_name(path: Path) -> float | None:
    """The exposure time in a file's name, None if there is none.

    Raises ConfigurationError for two times, or a time of 0.
    """
    found = _TIME_IN_NAME.findall(path.stem)
    if not found:
        return None
    if len(found) > 1:
        raise ConfigurationError(f"{path}: its name has {len(found)} exposure times: leave one")
    value = float(found[0][0]) * _SECONDS_PER_UNIT[found[0][1]]
    if value <= 0:
        raise ConfigurationError(f"{path}: its name has an exposure time of 0: give the real one")
    return value


def _exif_number(path: Path, tag: int) -> float | None:
    from PIL import Image  # noqa: PLC0415  of the extra, which a daemon that reads calibration files does not need

    try:
        with open_regular(path) as file, Image.open(file) as image:
            value = image.getexif().get_ifd(_EXIF_IFD).get(tag)
    except Exception as error:  # Pillow hardly checks what a damaged file claims
        raise ConfigurationError(f"{path}: is not a readable image: remove or replace it") from error
    if isinstance(value, tuple):
        value = value[0] if value else None
    try:
        number = math.nan if value is None else float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None  # cameras write 0/0 for what they do not know


def _exif_seconds(path: Path) -> float | None:
    value = _exif_number(path, _EXPOSURE_TIME)
    return value if value is not None and value > 0 else None


def _require_one(paths: list[Path], tag: int, name: str) -> None:
    """Refuse images between which anything but the exposure time changed."""
    first = _exif_number(paths[0], tag)
    for path in paths[1:]:
        value = _exif_number(path, tag)
        if value != first:
            raise ConfigurationError(
                f"{path}: its {name} is {value:g}, that of {paths[0].name} {first:g}: change the exposure time only"
                if value is not None and first is not None
                else f"{path}: EXIF has the {name} of some images only: give a list of exposure times"
            )


GREEN = 1
"""Its place among OpenCV's blue, green, red."""
MOST_IMAGE_BYTES = 1 << 30
"""More than the raw pixels of any sensor take."""


def read_images(source: Path) -> Sweep:
    """A sweep from the images of a folder or of a list; `exposure_times` says where their times come from.

    Colour images give their green channel: a single channel has one response and one saturation, a mix does not. Images
    of 16 bits whose pixels all stay below 4096 are taken as 12 bits in 16. The gain is not known and given as 0 dB.
    Raises ConfigurationError: one sentence that names the file, and the line where there is one.
    """
    return Sweep(_shots(timed_files(source)))


def read_pictures(folder: Path) -> tuple[Shot, ...]:
    """The images of a folder as `read_images` reads them; their exposure does not matter, and is given as 1 us.

    Raises ConfigurationError: one sentence that names the file.
    """
    if not folder.is_dir():
        raise ConfigurationError(f"{folder}: is not a folder: give one of pictures")
    return _shots([TimedFile(path, 1e-6) for path in image_paths(folder)])


def _shots(files: Sequence[TimedFile]) -> tuple[Shot, ...]:
    """The images in one size and depth."""
    images = [read_grey(file.path) for file in files]
    for file, image in zip(files[1:], images[1:], strict=True):
        if image.shape != images[0].shape or image.dtype != images[0].dtype:
            raise ConfigurationError(
                f"{file.path}: is {_described(image)}, {files[0].path.name} is {_described(images[0])}: "
                "take all images with one size and depth"
            )
    shallow = all(image.dtype == np.uint8 for image in images)
    bit_depth = 8 if shallow else 12 if max(image.max() for image in images) < 4096 else 16
    return tuple(
        Shot(image, bit_depth, ExposureSetting(file.exposure_s * 1e6, 0.0))
        for file, image in zip(files, images, strict=True)
    )


def _described(image: NDArray[Any]) -> str:
    return f"{image.shape[1]}x{image.shape[0]} pixels of {8 * image.dtype.itemsize} bits"


def read_grey8(path: Path) -> NDArray[np.uint8]:
    """An image in 8 bits, the green channel if it is in colour; deeper ones are read as in `read_images`.

    Raises ConfigurationError: one sentence that names the file.
    """
    image = read_grey(path)
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    return (image >> (4 if image.max() < 4096 else 8)).astype(np.uint8)


def read_grey(path: Path) -> Pixels:
    """An image of 8 or 16 bits, the green channel if it is in colour; raises ConfigurationError."""
    try:
        content = read_regular(path, MOST_IMAGE_BYTES)
        damaged = content.startswith(SIGNATURE) and not is_whole_png(content)
        flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
        image = None if damaged else cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except (OSError, cv2.error):
        image = None
    if image is None or image.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise ConfigurationError(f"{path}: is not a readable image of 8 or 16 bits: remove or replace it")
    one = image[..., GREEN] if image.ndim == 3 and image.shape[2] >= 3 else image
    return one.astype(np.uint8) if one.dtype == np.uint8 else one.astype(np.uint16)
