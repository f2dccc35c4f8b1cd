"""The geometry of a camera in `camera.txt` of the TUM mono data set, which DSO reads too."""

from __future__ import annotations

import re

from calibration.geometry.formats.rig import RigGeometry, lens_of, model_of
from calibration.geometry.numbers import numbers, size_of
from imaging.errors import ConfigurationError

_MODELS = ("pinhole", "fov", "atan", "radtan", "equidistant", "kannalabrandt")
_LONGEST_LINE = 1000


def is_camera_txt(text: str) -> bool:
    """Whether a file begins as such a one does: a model, or none, and five or eight numbers."""
    name, values = _first(text.lstrip().partition("\n")[0])
    return 5 <= len(values) <= 8 and (name != "" or not any(word[0].isalpha() for word in values))


def read_camera_txt(text: str) -> RigGeometry:
    """The camera of such a file; its third and fourth line, about rectified pictures, are left aside.

    Raises
    ------
    ConfigurationError
        Naming the line.
    """
    first, second, *_ = (*(line for line in text.splitlines() if line.strip()), "")
    name, words = _first(first)
    name, values = name or "FOV", numbers(words, "line 1", 5, 8)
    size = size_of(second, "line 2")
    if max(values[2:4]) <= 1.0:  # shares of the picture
        (width, height), (fx, fy, cx, cy, *bent) = size, values
        values = (fx * width, fy * height, cx * width - 0.5, cy * height - 0.5, *bent)
    model = model_of(name, "line 1")
    if len(values) != (5 if model == "fov" or name.lower() == "pinhole" else 8):
        raise ConfigurationError(f"line 1 has {len(values)} numbers after {name}: give 5 for Pinhole and FOV, else 8")
    extra = values[4:] if model == "fov" else ()
    if model == "fov" and values[4] == 0:
        model, extra = "pinhole", ()
    lens, notes = lens_of(size, model, values[:4], values[4:] if len(values) == 8 else (), extra)
    return RigGeometry(f"a camera of the TUM mono data set, {name}", {"camera": lens}, notes=notes)


def is_times_txt(text: str) -> bool:
    """Whether a file begins as `times.txt` does: lines of a number, a time in seconds and an exposure in ms."""
    lines = [line.partition("#")[0].split() for line in text[:_LONGEST_LINE].splitlines()]
    lines = [words for words in lines if words]
    number = r"\d+(\.\d+)?"
    return bool(lines) and len(lines[0]) in (2, 3) and all(re.fullmatch(number, word) for word in lines[0])


def _first(line: str) -> tuple[str, list[str]]:
    """The model, if the line begins with one, and the other words."""
    words = line[:_LONGEST_LINE].split()
    return (words[0], words[1:]) if words and words[0].lower() in _MODELS else ("", words)
