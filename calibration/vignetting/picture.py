"""A vignetting kept as a picture, as in the TUM mono data set: grey levels in proportion to the light of each pixel."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calibration.sources.images import read_grey
from calibration.vignetting.file import VignettingFile
from calibration.vignetting.solve import fit_grid, residuals
from imaging.errors import ConfigurationError

NODES = 32
"""Of the grid along the longer side: with straight lines between them, cos^4 down to 0.3 is missed by 0.1 %."""
_CELLS = 4 * NODES
_LEAST_PIXELS = 64


def read_vignette_picture(path: Path) -> VignettingFile:
    """The vignetting of frames of the picture's size, and how far its grid is from the picture at the worst place.

    Raises
    ------
    ConfigurationError
        When it is no picture of 8 or 16 bits, or no lens lets through so little somewhere.
    """
    picture = read_grey(path).astype(np.float64)
    height, width = picture.shape
    if min(width, height) < _LEAST_PIXELS:
        raise ConfigurationError(f"{path}: is {width}x{height} pixels: give one of the size of the camera's frames")
    scale = min(_CELLS / max(width, height), 1.0)
    cells = (round(scale * width), round(scale * height))
    light = np.asarray(cv2.resize(picture, cells, interpolation=cv2.INTER_AREA), np.float64)
    try:
        vignetting = fit_grid(light / max(light.max(), 1.0), (width, height), NODES)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    return VignettingFile(vignetting, error=round(float(np.abs(residuals(vignetting, light)).max()), 4))
