"""The interface of stereo odometry: pairs in, poses out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from fake_camera.world.render.renderer import Pinhole
from fake_camera.world.scene.path import BASELINE_M
from imaging.frames import StereoPair

GAMMA = 0.3
"""Brightens the dark parts before features are detected (Begin & Hunter 2022, section 3.1)."""

_CONTRAST = np.rint(255.0 * (np.arange(256) / 255.0) ** GAMMA).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class StereoCamera:
    """A rectified stereo camera without distortion.

    Attributes
    ----------
    focal_px
        Focal length, pixels.
    centre_px
        Where the optical axes intersect the images: x, y in pixels.
    baseline_m
        Distance of the right camera from the left one, metres.
    """

    focal_px: float
    centre_px: tuple[float, float]
    baseline_m: float

    @classmethod
    def simulated(cls) -> StereoCamera:
        """That of the fake cameras."""
        camera = Pinhole()
        return cls(camera.focal_px, ((camera.width - 1) / 2, (camera.height - 1) / 2), BASELINE_M)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What odometry returns for one pair.

    Attributes
    ----------
    pose
        Pose of the left camera in the frame of the first one: the matrix (4, 4) that takes its coordinates (m) there.
    lost
        Whether the pose is a guess, because the pair could not be tied to an earlier one.
    """

    pose: NDArray[np.float64]
    lost: bool


class StereoOdometry(Protocol):
    """Follows a stereo camera from pair to pair."""

    def track(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Tracked:
        """The pose at the next pair of images, uint8 (height, width), as `prepared` makes them.

        Always answers: a pair that cannot be tracked gets a guess and is marked as lost.
        """


def images(pair: StereoPair) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Both images of a complete pair as odometry gets them."""
    return prepared(pair.frames["left"].grey8()), prepared(pair.frames["right"].grey8())


def prepared(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image as the paper gives it to odometry: 3x3 median, then a gamma of 0.3."""
    return np.asarray(cv2.LUT(cv2.medianBlur(image, 3), _CONTRAST), np.uint8)
