"""What counts in a picture, without mask files: rectangles, and everything else."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from autoexpose_daemon.config.section import Extent, Pixel, Section, Weight

MOST_RECTANGLES = 256


class RectangleConfig(Section):
    """A rectangle in pixels of the camera's frames, `[x, y, width, height]`, and how much its pixels count."""

    box: tuple[Pixel, Pixel, Extent, Extent]
    weight: Weight = 1.0


class AreaConfig(Section):
    """What counts in the picture of one camera: rectangles, and everything else."""

    rectangles: Annotated[tuple[RectangleConfig, ...], Field(max_length=MOST_RECTANGLES)] = ()
    background_weight: Weight = 0.0
