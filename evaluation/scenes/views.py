"""What the cameras look at: rooms, randomly painted stills, and pictures of real radiance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.scenes.stills import PAINTERS, leaves, painting
from fake_camera.world.render.renderer import Pinhole, Renderer
from fake_camera.world.scene.panorama import load_radiance
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.simulation import RoomView, Side

CAMERA = Pinhole()

Gaze = Callable[[float], float]
"""Where the camera looks at a time (s): an angle in radians from the heading of the scene, positive to the left."""

WINDOW_HEADING_RAD = -math.pi / 2
"""The room's window is in its south wall."""

NEAR_WINDOW_M = (-0.2, -0.75)
"""From here the window fills the view, with no furniture in between."""

OPENING = (600, 860)
"""Height and width (pixels) of the window in stills: larger than the view."""

OUTDOORS_LUX = 1000.0
"""Light outside the window of stills, 8 stops above the 4 lux inside."""

DISPARITY_PX = 24.0
"""Of stills, where everything is at one distance."""

STILL_SIZE = (3000, 700)
"""Width and height of stills (pixels): room for the widest pan, one radian to either side, plus the view."""


@dataclass(frozen=True, slots=True)
class GazePath(CameraPath):
    """A camera that stays at one place in the room, looks where `gaze` says, and sways 10 cm as it turns."""

    gaze: Gaze = lambda _: 0.0
    place_m: tuple[float, float] = (0.0, 0.0)
    heading_rad: float = 0.0

    def pose(self, time_s: float) -> NDArray[np.float64]:
        """Pose of the left camera, camera to world, shape (4, 4)."""
        angle = self.gaze(time_s)
        yaw = self.heading_rad + angle
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = self.place_m
        sway = 0.1 * math.sin(angle)
        return np.array(
            [[sin, 0.0, cos, x + sway], [-cos, 0.0, sin, y], [0.0, -1.0, 0.0, self.height_m], [0.0, 0.0, 0.0, 1.0]]
        )


class Scene(Protocol):
    """Linear radiance at chosen instants, before any sensor."""

    def image_shift_px(self, start_s: float, end_s: float) -> float:
        """About how far the image moves between two instants, in pixels."""

    def radiance(self, times_s: NDArray[np.float64], lux: float) -> NDArray[np.float32]:
        """Mean radiance over the instants in lux times reflectance, shape (height, width); affine in `lux`."""


class StillView:
    """One camera's view of a still; a `Scene`.

    Parameters
    ----------
    interior
        Radiance per lux of light, float32, (rows, columns).
    outdoors
        Radiance that does not follow the light, same shape, or None.
    gaze
        Where the camera looks; 0 is the middle of the still.
    side
        "left" or "right".
    """

    def __init__(
        self, interior: NDArray[np.float32], outdoors: NDArray[np.float32] | None, gaze: Gaze, side: Side
    ) -> None:
        self._interior, self._outdoors, self._gaze = interior, outdoors, gaze
        self._shift_px = DISPARITY_PX if side == "right" else 0.0

    def image_shift_px(self, start_s: float, end_s: float) -> float:
        """How far the image moves between two instants, in pixels."""
        return CAMERA.focal_px * abs(self._gaze(end_s) - self._gaze(start_s))

    def radiance(self, times_s: NDArray[np.float64], lux: float) -> NDArray[np.float32]:
        """Mean radiance over the instants in lux times reflectance, shape (height, width); affine in `lux`."""
        total = np.zeros((CAMERA.height, CAMERA.width), np.float32)
        for time_s in times_s:
            total += self._at(self._interior, float(time_s)) * np.float32(lux)
            if self._outdoors is not None:
                total += self._at(self._outdoors, float(time_s))
        total /= np.float32(len(times_s))
        return total

    def _at(self, still: NDArray[np.float32], time_s: float) -> NDArray[np.float32]:
        rows, columns = still.shape
        centre = (columns / 2 - CAMERA.focal_px * self._gaze(time_s) + self._shift_px, rows / 2)
        return np.asarray(cv2.getRectSubPix(still, (CAMERA.width, CAMERA.height), centre), np.float32)


def build_views(scene: str, seed: int, gaze: Gaze, at_window: bool) -> dict[Side, Scene]:
    """Both cameras' views.

    Parameters
    ----------
    scene
        "room", a painter of `evaluation.scenes.stills`, or the path of a Radiance .hdr file.
    seed
        Decides the room or the painting, and where the camera looks first.
    gaze
        Where the camera looks over time.
    at_window
        Whether angle 0 is a window, brighter than everything else when the light is dim.
    """
    rng = np.random.default_rng([seed, 77])
    turn = float(rng.uniform(-1.0, 1.0))
    if scene == "room":
        # The demo's lap stays clear of the furniture, and so does every place inside it.
        bearing = rng.uniform(0, 2 * math.pi)
        place = NEAR_WINDOW_M if at_window else (0.3 * math.cos(bearing), 0.2 * math.sin(bearing))
        heading = WINDOW_HEADING_RAD if at_window else turn * math.pi
        path = GazePath(gaze=gaze, place_m=place, heading_rad=heading)
        renderer = Renderer(furnished_room(seed), CAMERA)
        return {side: RoomView(renderer, path, side) for side in ("left", "right")}
    interior, outdoors = _still(scene, seed, at_window)
    start = 0.0 if at_window else 0.35 * turn

    def turned(time_s: float) -> float:
        return start + gaze(time_s)

    return {side: StillView(interior, outdoors, turned, side) for side in ("left", "right")}


def _still(scene: str, seed: int, at_window: bool) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Interior and outdoors of a painting or picture."""
    interior = painting(scene, seed, *STILL_SIZE) if scene in PAINTERS else _wide(load_radiance(Path(scene)))
    if not at_window:
        return interior, None
    rows, columns = interior.shape
    height, width = OPENING
    trees = leaves(np.random.default_rng([seed, 79]), width, height) * np.float32(OUTDOORS_LUX)
    top, left = (rows - height) // 2, (columns - width) // 2
    opening = np.s_[top : top + height, left : left + width]
    outdoors = np.zeros_like(interior)
    outdoors[opening] = trees
    interior = interior.copy()
    interior[opening] = 0.0
    return interior, outdoors


def _wide(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """A picture enlarged to the height of stills and mirrored at its sides until it is wide enough."""
    scale = max(1.0, STILL_SIZE[1] / picture.shape[0])
    size = (math.ceil(picture.shape[1] * scale), math.ceil(picture.shape[0] * scale))
    large = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA)
    margin = max(0, STILL_SIZE[0] - large.shape[1]) // 2 + 1
    return np.maximum(cv2.copyMakeBorder(large, 0, 0, margin, margin, cv2.BORDER_REFLECT), np.float32(0.0))
