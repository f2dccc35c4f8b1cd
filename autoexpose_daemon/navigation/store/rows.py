"""What the rows of a map file contain, checked."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.parameters import FASTEST_M_S, FASTEST_TURN_RAD_S
from autoexpose_daemon.navigation.maps.adaptation import LocalMap
from autoexpose_daemon.navigation.maps.path import TaughtPath
from autoexpose_daemon.navigation.views.features import Features
from imaging.exposure import ExposureSetting

RunKind = Literal["teach", "repeat"]

DESCRIPTORS: Final[dict[str, tuple[np.dtype[Any], int]]] = {
    "fast-orb": (np.dtype(np.uint8), 32),
    "sift": (np.dtype("<f4"), 128),
}
"""Type and length of the descriptors, by detector."""

LARGEST_PX: Final = 1 << 16
LONGEST_PATH_M: Final = 1e6

HOUR_S, DAY_S = 3600.0, 86400.0

AS_BRIGHT_S: Final = 2 * HOUR_S
"""By then the sun has moved by 30 degrees, and lights things differently."""


class RowError(ValueError):
    """A row that no map of ours has."""


@dataclass(frozen=True, slots=True)
class MapInfo:
    """What holds for a whole map.

    Attributes
    ----------
    width, height
        Of its pictures (pixels).
    focal_length_px
        Of the lens.
    detector
        One of `DESCRIPTORS`.
    policy
        The exposure policy while it was taught; empty if unknown.
    """

    width: int
    height: int
    focal_length_px: float
    detector: str
    policy: str

    def check(self) -> MapInfo:
        """Itself; raises `RowError` for values that no map has."""
        sizes, texts = (self.width, self.height), (self.detector, self.policy)
        if not all(isinstance(size, int) for size in sizes) or not all(isinstance(text, str) for text in texts):
            raise RowError("types that no map of ours has")
        if not (0 < self.width <= LARGEST_PX and 0 < self.height <= LARGEST_PX):
            raise RowError(f"pictures of {self.width}x{self.height} pixels")
        if not 1.0 <= self.focal_length_px <= LARGEST_PX:
            raise RowError(f"a focal length of {self.focal_length_px:g} pixels")
        if self.detector not in DESCRIPTORS:
            raise RowError(f"a detector named {self.detector!a}; known are {', '.join(DESCRIPTORS)}")
        return self


@dataclass(frozen=True, slots=True)
class Run:
    """One drive along the path: its number, whether it taught or repeated, and when it began (s since 1970)."""

    number: int
    kind: RunKind
    start_s: float

    def __post_init__(self) -> None:
        if self.kind not in {"teach", "repeat"} or not 0.0 <= self.start_s < 1e11:
            raise RowError(f"a run of kind {self.kind!a} at {self.start_s:g} s")


def newest_of_hour(runs: Iterable[Run], now_s: float) -> Run | None:
    """The newest drive that began at this time of the day, give or take `AS_BRIGHT_S`; None if there is none."""

    def apart_s(run: Run) -> float:
        apart_s = abs(now_s - run.start_s) % DAY_S
        return min(apart_s, DAY_S - apart_s)

    return max((run for run in runs if apart_s(run) <= AS_BRIGHT_S), key=lambda run: run.number, default=None)


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A local map: how far along the path (m), what its picture was taken with, and its features.

    Attributes
    ----------
    next_feature
        The least number that none of its features ever had.
    """

    number: int
    distance_m: float
    setting: ExposureSetting
    next_feature: int
    map: LocalMap

    def __post_init__(self) -> None:
        if not 0.0 <= self.distance_m <= LONGEST_PATH_M:
            raise RowError(f"a local map at {self.distance_m:g} m")
        if not self.setting.is_physical:
            raise RowError(f"an exposure of {self.setting.exposure_time_us:g} us and {self.setting.gain_db:g} dB")


@dataclass(frozen=True, slots=True, eq=False)
class TaughtPlace:
    """A local map as taught: distance along the path (m), its JPEG picture, and the picture's setting and features."""

    distance_m: float
    jpeg: bytes
    setting: ExposureSetting
    features: Features


def taught_path(rows: Iterable[tuple[float, float, float]]) -> TaughtPath:
    """The path of rows of distance (m), forward (m/s) and turn (rad/s); raises `RowError`.

    Speeds beyond what `teach` takes are refused, because a robot would be told to drive like that.
    """
    columns = np.array([finite(*row) for row in rows], np.float64).reshape(-1, 3).T
    distances_m, forward_m_s, turn_rad_s = columns
    if (np.diff(distances_m) < 0).any():
        raise RowError("distances that fall along the path")
    if len(distances_m) and not 0.0 <= distances_m[0] <= distances_m[-1] <= LONGEST_PATH_M:
        raise RowError(f"a path from {distances_m[0]:g} to {distances_m[-1]:g} m")
    if (np.abs(forward_m_s) > FASTEST_M_S).any() or (np.abs(turn_rad_s) > FASTEST_TURN_RAD_S).any():
        raise RowError("a speed that no robot is told to drive at")
    return TaughtPath(*columns)


FeatureRow = tuple[int, float, float, float, bytes, int]
"""Id, x, y, response, descriptor, score."""


def local_map(rows: list[FeatureRow], info: MapInfo) -> LocalMap:
    """A map from its features, by ascending id; raises `RowError`."""
    dtype, length = DESCRIPTORS[info.detector]
    blobs = [row[4] for row in rows]
    if any(not isinstance(blob, bytes) or len(blob) != length * dtype.itemsize for blob in blobs):
        raise RowError(f"a descriptor that is not one of {info.detector}")
    descriptors = np.frombuffer(b"".join(blobs), dtype).reshape(-1, length)
    numbers = np.array([row[1:4] for row in rows], np.float64).reshape(-1, 3)
    if not np.isfinite(numbers).all() or not np.isfinite(descriptors).all():
        raise RowError("a feature with an infinite number")
    if (np.abs(numbers[:, :2]) > LARGEST_PX).any():
        raise RowError("a feature outside of its picture")
    features = Features(numbers[:, :2], numbers[:, 2], descriptors)
    return LocalMap(features, _whole([row[5] for row in rows]), _whole([row[0] for row in rows]))


def feature_rows(taken: LocalMap, detector: str) -> list[FeatureRow]:
    """The rows of a map's features."""
    dtype, _ = DESCRIPTORS[detector]
    features, descriptors = taken.features, taken.features.descriptors.astype(dtype, copy=False)
    return [
        (int(number), float(x), float(y), float(response), descriptor.tobytes(), int(score))
        for number, (x, y), response, descriptor, score in zip(
            taken.ids, features.positions, features.responses, descriptors, taken.scores, strict=True
        )
    ]


def states_of_blob(blob: bytes, features: int) -> NDArray[np.int8]:
    """The states of an observation; raises `RowError`."""
    states = np.frombuffer(blob, np.int8)
    if len(states) != features or not np.isin(states, (-1, 0, 1)).all():
        raise RowError(f"an observation of {len(states)} states for {features} features")
    return states


def finite(*numbers: float) -> tuple[float, ...]:
    """The numbers; raises `RowError` unless all are numbers, and finite."""
    if not all(isinstance(number, (int, float)) and math.isfinite(number) for number in numbers):
        raise RowError("a number that is infinite, or not a number")
    return numbers


def _whole(numbers: list[int]) -> NDArray[np.int64]:
    if not all(isinstance(number, int) and abs(number) < 1 << 62 for number in numbers):
        raise RowError("a number that is not whole")
    return np.array(numbers, np.int64)
