"""What a calibration file says of its cameras: lenses, and where each is."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.numbers import inverse_of
from calibration.geometry.plausible import check_plausible
from calibration.geometry.rectify import rectified
from imaging.errors import ConfigurationError
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The cameras of a file.

    Attributes
    ----------
    kind
        What the file is, in words.
    lenses
        Each camera by the file's name for it, in the file's order: left before right.
    places
        From axes that all have in common to those of each camera whose place is known: shape (4, 4), metres.
    is_rectified
        Whether R and P of the lenses are the file's; else each lens stands alone.
    notes
        What was done to what the file says, one line each.
    """

    kind: str
    lenses: Mapping[str, CameraGeometry]
    places: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    is_rectified: bool = False
    notes: tuple[str, ...] = ()

    def pair(self, left: str, right: str) -> tuple[CameraGeometry, CameraGeometry]:
        """Two of the cameras as a rectified pair.

        Raises
        ------
        ConfigurationError
            When the file does not know how they are placed, or they are no pair.
        """
        lenses = self._lens(left), self._lens(right)
        if self.is_rectified:
            return lenses
        if len({(lens.width, lens.height) for lens in lenses}) > 1:
            first, second = (f"{lens.width}x{lens.height} pixels" for lens in lenses)
            raise ConfigurationError(
                f"{left} has {first} and {right} has {second}: calibrate both with one size of frames"
            )
        for name in (left, right):
            if name not in self.places:
                raise ConfigurationError(
                    f"says nothing of where {name} is (R and T, or T_cn_cnm1 or T_cam_imu): calibrate both together"
                )
        pose = self.places[right] @ inverse_of(self.places[left])
        try:
            pair = rectified(*lenses, pose[:3, :3], pose[:3, 3])
        except ConfigurationError as error:
            raise ConfigurationError(
                f"{left} as the left camera, {right} as the right one: {error}; autoexpose calibrate import --cameras "
                "LEFT,RIGHT names them otherwise"
            ) from error
        for one in pair:
            check_plausible(one)
        return pair

    def scaled(self, unit_m: float) -> Rig:
        """The same for a file whose lengths are in another unit."""
        places = {name: place * np.array([[1.0, 1.0, 1.0, unit_m]]) for name, place in self.places.items()}
        return replace(self, places=places, lenses={name: _scaled(lens, unit_m) for name, lens in self.lenses.items()})

    def _lens(self, name: str) -> CameraGeometry:
        if name not in self.lenses:
            raise ConfigurationError(f"the key {name} is missing: it has {', '.join(self.lenses) or 'no lens'}")
        return self.lenses[name]


def side_of(name: str) -> Side | None:
    """By ROS's custom, the name of a camera of a pair ends in `left` or `right`, as in `narrow_stereo/left`."""
    last = re.split(r"[/_\W]", name)[-1].lower()
    return next((side for side in SIDES if side == last), None)


def joined(rigs: Mapping[str, Rig]) -> Rig:
    """The cameras of several files as one rig: those of one camera each become left and right.

    Raises
    ------
    ConfigurationError
        When two files contradict each other.
    """
    lenses: dict[str, CameraGeometry] = {}
    places: dict[str, NDArray[np.float64]] = {}
    single = [path for path, rig in rigs.items() if len(rig.lenses) == 1]
    for path, rig in rigs.items():
        named = {name: name for name in rig.lenses}
        if len(single) == len(SIDES) and path in single:
            (name,) = rig.lenses
            named = {name: side_of(name) or side_of(Path(path).stem) or SIDES[single.index(path)]}
        for name, new in named.items():
            if new in lenses and not _same(lenses[new], rig.lenses[name]):
                raise ConfigurationError(
                    f"{path}: {new} is in another of these files too, with other numbers: leave it out"
                )
            lenses[new] = rig.lenses[name]
        places |= {named.get(name, name): place for name, place in rig.places.items()}
    given = not places and all(rig.is_rectified for rig in rigs.values() if rig.lenses)
    given = given or (len(rigs) == 1 and next(iter(rigs.values())).is_rectified)
    return replace(next(iter(rigs.values())), lenses=lenses, places=places, is_rectified=given)


def _same(one: CameraGeometry, other: CameraGeometry) -> bool:
    return (one.camera_matrix, one.distortion) == (other.camera_matrix, other.distortion)


def _scaled(lens: CameraGeometry, unit_m: float) -> CameraGeometry:
    p = lens.projection
    return replace(lens, projection=(*p[:3], p[3] * unit_m, *p[4:]))
