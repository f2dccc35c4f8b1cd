"""One look at a flat field, and how far light and grey levels can be believed to be in proportion."""

from __future__ import annotations

import math
from dataclasses import dataclass

from calibration.vignetting.field import Array, Field


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A flat field from one place.

    Attributes
    ----------
    field
        What was seen.
    short
        The same with a shorter exposure time; None for pictures, which have none.
    time_ratio
        The shorter exposure time over the longer one.
    """

    field: Field
    short: Field | None = None
    time_ratio: float = 1.0

    @property
    def light(self) -> Array:
        """The light of each cell, relative to their mean, shape (rows, columns), over all that was seen."""
        return self.field.light if self.short is None else (self.field.light + self.short.light) / 2.0

    @property
    def slope(self) -> float | None:
        """Stops of light, as the response says, for a stop of exposure time: 1 if it holds; None: unknown."""
        if self.short is None or self.time_ratio >= 1.0 or min(self.short.level, self.field.level) <= 0:
            return None
        return math.log2(self.short.level / self.field.level) / math.log2(self.time_ratio)
