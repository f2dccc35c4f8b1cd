"""Photometric files of the TUM mono data set, as our own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from calibration.geometry.formats.tum import is_times_txt
from calibration.geometry.numbers import numbers
from calibration.response.file import ResponseFile
from calibration.response.tum import is_tum_table, read_tum_table
from calibration.sources.exposure_times import image_paths
from calibration.vignetting.file import VignettingFile
from calibration.vignetting.picture import read_vignette_picture
from documents.files import SIGNATURE, open_regular, read_text
from imaging.errors import ConfigurationError
from imaging.frames import Side

TIMES = "images.txt"
_MOST_TIMES_BYTES = 1 << 24


@dataclass(slots=True)
class Imported:
    """What the files give: our own files by name, what each is said to be, and keys of the configuration."""

    texts: dict[str, str] = field(default_factory=dict)
    files: dict[str, ResponseFile | VignettingFile] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)


def take_photometric(path: Path, side: Side, found: Imported) -> bool:
    """Take a file of the TUM mono data set that is not about geometry; False if it is none.

    Raises
    ------
    ConfigurationError
        Naming the file and the line.
    """
    if _begins_as_png(path):
        vignetting = read_vignette_picture(path)
        lens = vignetting.vignetting
        _take(found, f"{side}.vignetting.yaml", f"cameras.{side}.vignetting", vignetting)
        corner = lens.relative_light(len(lens.grid), len(lens.grid[0]))[[0, 0, -1, -1], [0, -1, 0, -1]].min()
        found.said.append(
            f"{path}: light of each pixel, {lens.width}x{lens.height}: {corner:.2f} in the darkest corner, its grid "
            f"off by at most {vignetting.error:.1%}"
        )
        return True
    text = read_text(path, _MOST_TIMES_BYTES)
    if is_tum_table(text):
        try:
            response = read_tum_table(text)
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from error
        _take(found, f"{side}.response.yaml", f"cameras.{side}.response", ResponseFile(response))
        black, full = response.black_level, response.saturation
        found.said.append(f"{path}: response, 256 grey levels, black level {black}, saturation {full}")
        return True
    if is_times_txt(text):
        found.texts[TIMES] = "".join(_timed(path, text))
        found.said.append(f"{path}: exposure times of {found.texts[TIMES].count(chr(10))} images")
        return True
    return False


def _take(found: Imported, name: str, key: str, file: ResponseFile | VignettingFile) -> None:
    if name in found.files:
        raise ConfigurationError(f"two of the files are {key}: import them one by one, with --side")
    found.files[name], found.keys[key] = file, name


def _begins_as_png(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}): check its name and access") from error


def _timed(path: Path, text: str) -> Iterator[str]:
    """Lines of a list of images and seconds, from those of `times.txt`: number, time, exposure in ms."""
    folder = next((each for each in (path.parent / "images", path.parent) if each.is_dir() and image_paths(each)), None)
    images = {} if folder is None else {image.stem: image for image in image_paths(folder)}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) < 3:
            raise ConfigurationError(f"{path}: line {number}: has no exposure time: give number, time, exposure in ms")
        (exposure_ms,) = numbers([words[2]], f"{path}: line {number}")
        if words[0] not in images:
            raise ConfigurationError(
                f"{path}: line {number}: there is no image {words[0]} in {path.parent / 'images'}: unpack them there"
            )
        yield f"{images[words[0]].resolve()} {1e-3 * exposure_ms:.9g}\n"
