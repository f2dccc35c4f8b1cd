"""A vignetting file: what a lens lets through, and how well that is known; ours, and the picture of TUM mono."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import Field, Strict, model_validator

from calibration.document import (
    CalibrationDocument,
    MeasuredFile,
    Number,
    located,
    optional,
    read_document,
    within,
    write_document,
)
from calibration.images import read_grey
from calibration.vignetting.result import fit_grid, residuals
from documents.bounds import Range
from imaging.errors import ConfigurationError
from imaging.python310 import Self
from imaging.vignetting import MOST_COEFFICIENTS, Vignetting

FORMAT = "autoexpose-vignetting/1"
_Pixels = Annotated[int, Strict()]


@dataclass(frozen=True, slots=True)
class VignettingFile(MeasuredFile):
    """A vignetting, the camera it belongs to, and how well it is known."""

    vignetting: Vignetting
    error: float | None = None  # how far relative light may be from the truth, as a share; None: the file does not say

    @classmethod
    def load(cls, path: Path) -> VignettingFile:
        """Read a vignetting file. Raises ConfigurationError naming the file, the key and what to do."""
        document = read_document(_Document, path, FORMAT)
        with located(path):
            return cls(document.vignetting(), document.error, **document.measured(path))

    def save(self, path: Path) -> None:
        """Write the file. Raises ConfigurationError when it cannot be written."""
        document = {
            "format": FORMAT,
            "camera": self.camera and asdict(self.camera),
            "date": self.date,
            "tool": self.tool,
            "error": self.error,
            "findings": [asdict(finding) for finding in self.findings],
            **self.vignetting.as_plain(),
        }
        write_document(path, document)

    def check_belongs(self, serial: str, size: tuple[int, int] | None = None) -> None:
        """Refuse a file of another camera, or of frames of another size; an unknown size (None) is not compared.

        Raises ConfigurationError naming file, camera and what to do.
        """
        self.check_camera(serial, "vignette")
        if size is not None:
            with located(self.path):
                self.vignetting.check_size(size, f"camera {serial}")


class _Document(CalibrationDocument):
    """All keys of a vignetting file."""

    format: Literal["autoexpose-vignetting/1"] = Field(description=f"only {FORMAT!r} can be read")
    width: _Pixels = Field(description="give the width of the frames in pixels")
    height: _Pixels = Field(description="give the height of the frames in pixels")
    centre_px: tuple[Number, Number] | None = optional("give column and row")
    coefficients: Annotated[tuple[Number, ...], Field(min_length=1, max_length=MOST_COEFFICIENTS)] | None = Field(
        None, description=f"give a2, a4, ... of the polynomial, at most {MOST_COEFFICIENTS} numbers, or a grid instead"
    )
    grid: tuple[tuple[Number, ...], ...] | None = Field(
        None, description="give rows of relative light, or coefficients instead"
    )
    error: Annotated[Number, within(Range(0.0, 1.0))] | None = optional("give a share of the light, 0 to 1")

    @model_validator(mode="after")
    def _is_one_kind(self) -> Self:
        if (self.coefficients is None) == (self.grid is None):
            raise ValueError("give one of coefficients and grid")
        if self.centre_px is not None and self.grid is not None:
            raise ValueError("centre_px belongs to coefficients: remove it")
        return self

    def vignetting(self) -> Vignetting:
        """The vignetting; raises ConfigurationError, as that does."""
        centre_px = self.centre_px or ((self.width - 1) / 2.0, (self.height - 1) / 2.0)
        return Vignetting(self.width, self.height, centre_px, self.coefficients or (), self.grid or ())


NODES = 32
"""Of the grid along the longer side: with straight lines between them, cos^4 down to 0.3 is missed by 0.1 %."""
_CELLS = 4 * NODES
_LEAST_PIXELS = 64


def read_vignette_picture(path: Path) -> VignettingFile:
    """The vignetting of frames of the picture's size, and how far its grid is from the picture at the worst place.

    Raises ConfigurationError when it is no picture of 8 or 16 bits, or no lens lets through so little somewhere.
    """
    picture = read_grey(path).astype(np.float64)
    height, width = picture.shape
    if min(width, height) < _LEAST_PIXELS:
        raise ConfigurationError(f"{path}: is {width}x{height} pixels: give one of the size of the camera's frames")
    scale = min(_CELLS / max(width, height), 1.0)
    cells = (round(scale * width), round(scale * height))
    light = np.asarray(cv2.resize(picture, cells, interpolation=cv2.INTER_AREA), np.float64)
    with located(path):
        vignetting = fit_grid(light / max(light.max(), 1.0), (width, height), NODES)
    return VignettingFile(vignetting, error=round(float(np.abs(residuals(vignetting, light)).max()), 4))
