"""Exposure times of image files: from EXIF, from their names, or from a list (`exposure_lists`).

In a name, the time is a number right before `us`, `ms` or `s`, followed by no letter or digit, once in the
name: `img_0.0333s.png`, `img_5000us.png`, `wall-2.5ms-b.tif`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from calibration.sources.exposure_lists import read_list
from documents.files import open_regular
from imaging.errors import ConfigurationError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm")

_EXIF_IFD, _EXPOSURE_TIME, _F_NUMBER, _SENSITIVITY = 0x8769, 0x829A, 0x829D, 0x8827
_TIME_IN_NAME = re.compile(r"(?<![\d.])(\d+(?:\.\d+)?)(us|ms|s)(?![0-9A-Za-z])")
_TUM_LIST = "times.txt"
_SECONDS_PER_UNIT = {"us": 1e-6, "ms": 1e-3, "s": 1.0}


@dataclass(frozen=True, slots=True)
class TimedFile:
    """An image file and its exposure time in seconds."""

    path: Path
    exposure_s: float


def timed_files(source: Path) -> list[TimedFile]:
    """The images of a folder (in the order of their names, timed by EXIF or else by name), or of a list.

    A folder that holds a `times.txt`, as those of the TUM mono data set, is timed by that list.

    Raises
    ------
    ConfigurationError
        Naming the file and the line at fault.
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

    Raises
    ------
    ConfigurationError
        For two times, or a time of 0.
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
