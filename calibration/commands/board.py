"""The command `autoexpose calibrate board`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from calibration.commands.measure_geometry import Dictionary, MarkerMm, SquareMm, Squares, board_of
from calibration.geometry.board import DEFAULT_DICTIONARY, Board
from calibration.report import check_extra
from imaging.errors import ConfigurationError

PIXELS_PER_MM = 10
MARGIN_MM = 10


def board(
    output: Path,
    *,
    squares: Squares = "9x6",
    square_mm: SquareMm = 30.0,
    marker_mm: MarkerMm = None,
    dictionary: Dictionary = DEFAULT_DICTIONARY,
) -> None:
    """Draw a ChArUco board to print at 100 %, as a .pdf or .png file; the default fits A4."""
    check_extra()
    from PIL import Image  # noqa: PLC0415  an extra

    if output.suffix.lower() not in (".pdf", ".png"):
        raise ConfigurationError(f"{output}: name a .pdf or .png file")
    drawn = board_picture(board_of(squares, square_mm, marker_mm, dictionary))
    dots_per_inch = 25.4 * PIXELS_PER_MM
    try:
        Image.fromarray(drawn).save(output, resolution=dots_per_inch, dpi=(dots_per_inch, dots_per_inch))
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written ({error.strerror}): choose another place") from error
    height_mm, width_mm = (side / PIXELS_PER_MM for side in drawn.shape)
    typer.echo(f"written: {output}, {width_mm:g} x {height_mm:g} mm: print it at 100 %, and measure a square")


def board_picture(board: Board) -> NDArray[np.uint8]:
    """The board in `PIXELS_PER_MM`, with a white margin that says what it is; shape (height, width)."""
    size = [round(1e3 * board.square_m * count * PIXELS_PER_MM) for count in (board.columns, board.rows)]
    margin = MARGIN_MM * PIXELS_PER_MM
    drawn = np.pad(np.asarray(board.charuco.generateImage(size), np.uint8), margin, constant_values=255)
    at = (margin, drawn.shape[0] - margin // 3)
    return np.asarray(cv2.putText(drawn, str(board), at, cv2.FONT_HERSHEY_SIMPLEX, 1.2, 0, 2, cv2.LINE_AA), np.uint8)
