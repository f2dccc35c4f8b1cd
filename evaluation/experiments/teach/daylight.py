"""Daylight: sun and sky at one time of day, and the light they send onto surfaces and into the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

BOUNCE = 0.1
"""Light reflected from the ground onto upright surfaces, as a share of the light on level ground."""

GLOW_WIDTH_DEG, GLOW_HEIGHT_DEG = 40.0, 18.0
"""Extent of the bright sky around the sun."""

HAZE_HEIGHT_DEG = 10.0
"""Above the horizon, haze falls to 1/e over this angle."""


@dataclass(frozen=True, slots=True)
class Daylight:
    """Sun and sky. All radiances are in lux times reflectance per lux that falls on open level ground.

    An even sky that gives all of the light has radiance 1 everywhere, so a sky that gives the share 1 - direct has
    about that radiance, with more at the horizon and around the sun.

    Attributes
    ----------
    sun_azimuth_deg, sun_elevation_deg
        Where the sun stands; azimuth 0 is east, counted to the north.
    direct
        Share of the light that comes directly from the sun.
    haze
        How much brighter the horizon is than the zenith.
    glow
        Radiance added around the sun.
    first_lux, last_lux
        Light on open level ground when the drive begins and ends, in the units of the fake camera's sensor. Outdoors
        its lens is stopped down, so 1000 of these stand for about 20000 lux.
    day
        Seed of what changes from day to day (clouds and leaves); 0 is the day of teaching.
    grown
        Share (0..1) of the leaves that others have replaced for good since then.
    """

    sun_azimuth_deg: float
    sun_elevation_deg: float
    direct: float
    haze: float
    glow: float
    first_lux: float
    last_lux: float
    day: int
    grown: float = 0.0

    def lux(self, progress: float) -> float:
        """Light at a share (0..1) of the drive; equal shares change it by equal factors."""
        return float(self.first_lux * (self.last_lux / self.first_lux) ** progress)

    def on_upright(self, outward_deg: float) -> float:
        """Light on a wall whose outward normal has an azimuth, per lux on level ground."""
        facing = math.cos(math.radians(outward_deg - self.sun_azimuth_deg))
        direct = self.direct * max(facing, 0.0) / math.tan(math.radians(self.sun_elevation_deg))
        return direct + (1.0 - self.direct) / 2 + BOUNCE

    def sky(self, azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> NDArray[np.float32]:
        """Radiance of the sky without clouds; azimuth and elevation are broadcast against each other."""
        azimuth, elevation = np.asarray(azimuth_deg, np.float32), np.asarray(elevation_deg, np.float32)
        away = (azimuth - self.sun_azimuth_deg + 180.0) % 360.0 - 180.0
        above = elevation - self.sun_elevation_deg
        even = (1.0 - self.direct) * 0.8 * (1.0 + self.haze * np.exp(-elevation / HAZE_HEIGHT_DEG))
        glow = self.glow * np.exp(-((away / GLOW_WIDTH_DEG) ** 2) - (above / GLOW_HEIGHT_DEG) ** 2)
        return np.asarray(even + glow, np.float32)


TEACHING = Daylight(230.0, 40.0, direct=0.75, haze=1.5, glow=2.0, first_lux=2000.0, last_lux=2000.0, day=0)
"""Early in the afternoon, the sun high."""

REPLAYS = {
    "clear": Daylight(195.0, 20.0, direct=0.7, haze=1.5, glow=3.0, first_lux=1000.0, last_lux=900.0, day=1),
    "overcast": Daylight(195.0, 20.0, direct=0.0, haze=0.0, glow=0.0, first_lux=500.0, last_lux=550.0, day=2),
    "sunset": Daylight(180.0, 1.0, direct=0.0, haze=0.8, glow=7.0, first_lux=40.0, last_lux=10.0, day=3),
}
"""Late in the afternoon, in steady light: under a clear sky, where shadows have moved and what faces the sun is almost
as bright as the sky, or under an overcast sky, 3 to 4 stops brighter than the trees. And after sunset, when only the
sky gives light, which falls by two stops during the drive."""

STEADY = ("clear", "overcast")
"""The replays late in the afternoon."""
