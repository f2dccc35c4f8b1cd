"""The interface of stereo odometry, pairs in and poses out, and the error of an estimated trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from evaluation.arrays import Floats, Greys
from fake_camera.world.render.renderer import Pinhole
from fake_camera.world.scene.path import BASELINE_M
from imaging.frames import FrameSet

GAMMA = 0.3  # Brightens the dark parts before features are detected (Begin & Hunter 2022, section 3.1)
_CONTRAST = np.rint(255.0 * (np.arange(256) / 255.0) ** GAMMA).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class StereoCamera:
    """A rectified stereo camera without distortion."""

    focal_px: float  # focal length, pixels
    centre_px: tuple[float, float]  # where the optical axes intersect the images: x, y in pixels
    baseline_m: float  # distance of the right camera from the left one, metres

    @classmethod
    def simulated(cls) -> StereoCamera:
        """That of the fake cameras."""
        camera = Pinhole()
        return cls(camera.focal_px, ((camera.width - 1) / 2, (camera.height - 1) / 2), BASELINE_M)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What odometry returns for one pair."""

    # Pose of the left camera in the frame of the first one: the matrix (4, 4) that takes its coordinates (m) there.
    pose: Floats
    lost: bool  # whether the pose is a guess, because the pair could not be tied to an earlier one


class StereoOdometry(Protocol):
    """Follows a stereo camera from pair to pair."""

    def track(self, left: Greys, right: Greys) -> Tracked:
        """The pose at the next pair of images, uint8 (height, width), as `prepared` makes them. Always answers: a pair
        that cannot be tracked gets a guess and is marked as lost."""


def images(pair: FrameSet) -> tuple[Greys, Greys]:
    """Both images of a complete pair as odometry gets them."""
    return prepared(pair.frames["left"].grey8()), prepared(pair.frames["right"].grey8())


def prepared(image: Greys) -> Greys:
    """An image as the paper gives it to odometry: 3x3 median, then a gamma of 0.3."""
    return np.asarray(cv2.LUT(cv2.medianBlur(image, 3), _CONTRAST), np.uint8)


SUB_TRAJECTORY_M = 0.02  # Path length over which errors accumulate (Begin & Hunter 2022, section 3.1)
TOLERANCE = 0.1  # By which share a sub-trajectory's length may be off


def relative_errors_mm(
    truth: Sequence[Floats],
    estimate: Sequence[Floats],
    length_m: float = SUB_TRAJECTORY_M,
    tolerance: float = TOLERANCE,
) -> list[float]:
    """Translation RPE (mm) over each sub-trajectory of a length, one beginning at every pose. Lengths are measured
    along the true path: the estimated one is longer because of its noise. `truth`, `estimate`: poses (4, 4) in metres
    at the same instants, each in its own frame of reference. `length_m`, `tolerance`: of a sub-trajectory, and by which
    share it may be off."""
    from evo.core.metrics import RPE, PoseRelation, Unit  # noqa: PLC0415  takes half a second to load
    from evo.core.trajectory import PosePath3D  # noqa: PLC0415

    errors = RPE(
        PoseRelation.translation_part, length_m, Unit.meters, rel_delta_tol=tolerance, all_pairs=True,
        pairs_from_reference=True,
    )  # fmt: skip
    errors.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate))))
    return [1e3 * float(error) for error in errors.error]
