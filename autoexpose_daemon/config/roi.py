"""The section `control.roi`: what counts in the pictures of the cameras."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.config.area import AreaConfig
from autoexpose_daemon.config.section import FileName, Section
from autoexpose_daemon.control.picture.region import Rectangle, Region
from documents.files import is_whole_png, read_regular
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.frames import Side

MOST_MASK_BYTES = 1 << 26
"""More than any sensor's mask needs as a PNG file: masks are mostly black and white."""


class RegionConfig(AreaConfig):
    """What counts in the picture of one camera, with a mask file too."""

    mask: FileName | None = None


class RoiConfig(Section):
    """The regions of both cameras; without one, all of the picture counts."""

    left: RegionConfig | None = None
    right: RegionConfig | None = None

    def configured(self) -> dict[Side, RegionConfig]:
        """The configured regions, left first."""
        both: dict[Side, RegionConfig | None] = {"left": self.left, "right": self.right}
        return {side: region for side, region in both.items() if region is not None}

    @cached_property
    def regions(self) -> dict[Side, Region]:
        """The configured regions; their masks are read once.

        Raises
        ------
        ConfigurationError
            Names key and file of a mask that cannot be used.
        """
        return {side: _region(side, region) for side, region in self.configured().items()}

    def relative_to(self, folder: Path) -> RoiConfig:
        """The same with mask files below `folder`, unless they are absolute."""
        return self.model_copy(
            update={
                side: region.model_copy(update={"mask": region.mask and folder / region.mask})
                for side, region in self.configured().items()
            }
        )


def region_of(key: str, area: AreaConfig) -> Region:
    """An area as a region that errors call `key`; raises ConfigurationError if nothing in it counts."""
    rectangles = tuple(Rectangle(*rectangle.box, rectangle.weight) for rectangle in area.rectangles)
    region = Region(key, rectangles, area.background_weight)
    region.check_something_counts()
    return region


def _region(side: Side, config: RegionConfig) -> Region:
    key = f"control.roi.{side}"
    if config.mask is None:
        return region_of(key, config)
    rectangles = tuple(Rectangle(*rectangle.box, rectangle.weight) for rectangle in config.rectangles)
    mask = _read_mask(f"{key}.mask", config.mask)
    region = Region(f"{key} ({config.mask})", rectangles, config.background_weight, mask)
    region.weights(mask.shape)  # only the frames show whether the mask has their size
    return region


def _read_mask(key: str, path: Path) -> NDArray[np.uint8]:
    """The grey levels of a mask file: uint8, shape (height, width)."""
    try:
        content = read_regular(path, MOST_MASK_BYTES)
    except OSError as error:
        raise ConfigurationError(f"{key}: {path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # a NUL in its name
        raise ConfigurationError(f"{key}: {quoted(str(path))}: is not a valid file name: {error}") from error
    mask = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if is_whole_png(content) else None
    if mask is None:
        raise ConfigurationError(f"{key}: {path}: is not a PNG picture: save the mask as one")
    if mask.ndim != 2 or mask.dtype != np.uint8:
        raise ConfigurationError(f"{key}: {path}: is not 8-bit grey without alpha: convert it")
    if not mask.any():
        raise ConfigurationError(f"{key}: {path}: is entirely black, so nothing would count: draw what counts in white")
    return mask.astype(np.uint8, copy=False)
