"""A sweep from image files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.sources.exposure_times import TimedFile, image_paths, timed_files
from calibration.sources.sweep import Shot, Sweep
from documents.files import SIGNATURE, is_whole_png, read_regular
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.pixels import Pixels

GREEN = 1
"""Its place among OpenCV's blue, green, red."""
MOST_IMAGE_BYTES = 1 << 30
"""More than the raw pixels of any sensor take."""


def read_images(source: Path) -> Sweep:
    """A sweep from the images of a folder or of a list; `exposure_times` says where their times come from.

    Colour images give their green channel: a single channel has one response and one saturation, a mix does not.
    Images of 16 bits whose pixels all stay below 4096 are taken as 12 bits in 16. The gain is not known and given as
    0 dB.

    Raises
    ------
    ConfigurationError
        One sentence that names the file, and the line where there is one.
    """
    return Sweep(_shots(timed_files(source)))


def read_pictures(folder: Path) -> tuple[Shot, ...]:
    """The images of a folder as `read_images` reads them; their exposure does not matter, and is given as 1 us.

    Raises
    ------
    ConfigurationError
        One sentence that names the file.
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

    Raises
    ------
    ConfigurationError
        One sentence that names the file.
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
