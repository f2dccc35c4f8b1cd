"""The world of one camera: a scene under a light script, seen by a sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fake_camera.imaging import PIXEL_FORMATS, ImageSettings, ImageSource, Pixels
from fake_camera.places import Side
from fake_camera.world.colour import Tints
from fake_camera.world.lighting import LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.scene.board import BoardPath, board_on_a_wall
from fake_camera.world.scene.panorama import Panorama, load_radiance
from fake_camera.world.scene.path import CameraPath, right_of, turn_right
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.scene.wall import Wall
from fake_camera.world.sensor import DEFAULT_F_NUMBER, SIZES, Sensor, SensorModel
from fake_camera.world.steered import Steered

_GOLDEN_RATIO = (1.0 + math.sqrt(5.0)) / 2.0
"""Neighbours in the order of surfaces get different hues."""

_LONGEST_PART_PX = 16.0
"""A longer motion is rendered in parts. The corners of the image, and near things, move by up to a third more."""

_MOST_PARTS = 256
"""Orders may move a steered camera at any speed; nobody can tell the blur of so long a motion from a longer one's."""


class Scene(Protocol):
    """Linear radiance, before any sensor."""

    def exposed(self, start_s: float, exposure_s: float, lux: float) -> NDArray[np.float32]:
        """Mean radiance over an exposure, in lux times reflectance, shape (height, width); affine in `lux`.

        The next call overwrites the result.
        """

    def tints(self, time_s: float) -> Tints:
        """The colours of the light, (height, width), until the next call."""
        ...


class Trajectory(Protocol):
    """Where the left camera is."""

    def pose(self, time_s: float) -> NDArray[np.float64]:
        """Camera to world, shape (4, 4)."""
        ...


class Light(Protocol):
    """Illumination over the time since the wire's epoch."""

    def lux(self, time_s: float) -> float:
        """At a time, with flicker averaged out."""
        ...

    def mean_lux(self, start_s: float, exposure_s: float) -> float:
        """Over an exposure."""
        ...


class RoomView:
    """What one camera of a stereo pair sees of the furnished room along the path.

    The pair is turned to the right of the path, and what it sees there has more light on it.
    """

    def __init__(
        self, renderer: Renderer, path: Trajectory, side: Side, yaw_deg: float = 0.0, sunlit_stops: float = 0.0
    ) -> None:
        self._renderer = renderer
        self._numbers: Renderer | None = None
        self._path = path
        self._side = side
        self._turn = turn_right(yaw_deg)
        self._light = 2.0**sunlit_stops

    def pose(self, time_s: float) -> NDArray[np.float64]:
        """Pose of this camera, camera to world, shape (4, 4)."""
        pose = self._path.pose(time_s) @ self._turn
        return right_of(pose) if self._side == "right" else pose

    def image_shift_px(self, start_s: float, end_s: float) -> float:
        """Roughly how far the image moves between two instants, by the turn and by the distance seen from 1 m."""
        start, end = self.pose(start_s), self.pose(end_s)
        turn_rad = math.acos(min(max(float(start[:3, 2] @ end[:3, 2]), -1.0), 1.0))
        return self._renderer.camera.focal_px * (turn_rad + math.dist(start[:3, 3], end[:3, 3]))

    def radiance(self, times_s: NDArray[np.float64], lux: float) -> NDArray[np.float32]:
        """Mean radiance over the instants in lux times reflectance, shape (height, width), until the next call."""
        return self._renderer.render(np.array([self.pose(float(time_s)) for time_s in times_s]), lux * self._light)

    def exposed(self, start_s: float, exposure_s: float, lux: float) -> NDArray[np.float32]:
        """Mean radiance over an exposure, see `Scene`; the cost hardly depends on the motion."""
        shift_px = self.image_shift_px(start_s, start_s + exposure_s)
        parts = min(max(math.ceil(shift_px / _LONGEST_PART_PX), 1), _MOST_PARTS)
        times_s = start_s + exposure_s * np.linspace(0.0, 1.0, 2 * parts + 1)
        poses = [self.pose(float(time_s)) for time_s in times_s]
        return self._renderer.render_motion(
            np.array([poses[i : i + 3] for i in range(0, 2 * parts, 2)]), lux * self._light
        )

    def tints(self, time_s: float) -> Tints:
        """Those of the surfaces seen at an instant, see `Scene`: their edges are not blurred by motion."""
        if self._numbers is None:
            self._numbers = self._renderer.of_numbers()
        return Tints(self._numbers.render(self.pose(time_s)[None], 1.0), paints(len(self._renderer.surfaces)))


def paints(count: int) -> NDArray[np.float32]:
    """A colour for each surface, from number 1 on, all round the colour circle; number 0, no surface, is grey.

    Red, green and blue, shape (count + 1, 3); of each colour the mean is 1, and none is beyond 1.5.
    """
    hue = 2.0 * math.pi * (np.arange(count + 1)[:, None] * _GOLDEN_RATIO - np.arange(3) / 3.0)
    colours = 1.0 + 0.5 * np.cos(hue)
    colours[0] = 1.0
    return colours.astype(np.float32)


class SimulatedCamera:
    """An `ImageSource`: a scene under a light script, exposed by a sensor. It reads no clock. Not thread-safe.

    With `still` the camera stays where it is at time 0, and the scene is rendered again only when the light changes.
    """

    def __init__(self, scene: Scene, light: Light, sensor: Sensor, *, still: bool = False) -> None:
        self.sensor_width = sensor.model.width
        self.sensor_height = sensor.model.height
        self._scene = scene
        self._light = light
        self._sensor = sensor
        self._still = still
        self._rendered: tuple[float, NDArray[np.float32]] | None = None
        self._tints_at_rest: Tints | None = None

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        """The image of one exposure, see `ImageSource.take`, with the motion and the light during it."""
        exposure_s = settings.exposure_time_us * 1e-6
        lux = self._light.mean_lux(start_s, exposure_s)
        radiance = self._at_rest(lux) if self._still else self._scene.exposed(start_s, exposure_s, lux)
        tints = self._tints(start_s + exposure_s / 2) if PIXEL_FORMATS[settings.pixel_format].colours else None
        return self._sensor.expose(radiance, settings, noise_seed, tints)

    def lux(self, time_s: float) -> float:
        """Illumination of the light script at `time_s`, with flicker averaged out."""
        return self._light.lux(time_s)

    def _at_rest(self, lux: float) -> NDArray[np.float32]:
        if self._rendered is None or self._rendered[0] != lux:
            self._rendered = lux, self._scene.exposed(0.0, 0.0, lux)
        return self._rendered[1]

    def _tints(self, time_s: float) -> Tints:
        if not self._still:
            return self._scene.tints(time_s)
        if self._tints_at_rest is None:
            self._tints_at_rest = self._scene.tints(0.0)
        return self._tints_at_rest


def build_image_source(
    scene: str,
    side: Side,
    light: LightScript,
    seed: int,
    response: str = "linear",
    *,
    still: bool = False,
    paint: Callable[[int], Sequence[Surface]] = furnished_room,
    lens_f_number: float = DEFAULT_F_NUMBER,
    corner_light: float = 1.0,
    steered: Steered | None = None,
    size: tuple[int, int] = SIZES[0],
    yaw_deg: float = 0.0,
    sunlit_stops: float = 0.0,
) -> ImageSource:
    """Build the world of one camera. The first image of each pixel format is slow unless kernels are compiled.

    Raises ValueError, which says what is wrong with the file, or that the response function is unknown.

    Parameters
    ----------
    scene
        "room"; "board", a wall with a ChArUco board; "wall", an evenly lit grey one; or the path of a Radiance .hdr
        file to pan across.
    side
        Which camera of the stereo pair this is; both must be built with the same scene, light and seed.
    light
        Illumination over time.
    seed
        Determines the room and, with the side, the noise.
    response
        Name of the sensor's response function.
    still
        Whether the camera does not move, as on a tripod.
    paint
        Makes the room for a seed.
    lens_f_number
        Of the lens.
    corner_light
        What its vignetting leaves in the corners, as a share of the centre.
    steered
        Decides path and light in the room, instead of the time.
    size
        Width and height of the sensor, pixels; the angle of view across is the same for all.
    yaw_deg, sunlit_stops
        In the room: how far its pair is turned to the right of the path, and how much more light is on what it sees.
    """
    model = SensorModel(*size, lens_f_number=lens_f_number, corner_light=corner_light)
    sensor = Sensor(model, 2 * seed + (side == "right") + 1000 * round(yaw_deg % 360), response)
    view: Scene
    if scene in ("room", "board"):
        lens = Pinhole()
        camera = Pinhole(model.width, model.height, lens.focal_px * model.width / lens.width)
        board = scene == "board"
        renderer = Renderer(board_on_a_wall(seed) if board else paint(seed), camera)
        view = RoomView(renderer, BoardPath(seed) if board else steered or CameraPath(), side, yaw_deg, sunlit_stops)
    elif scene == "wall":
        view = Wall(model.width, model.height)
    else:
        view = Panorama(load_radiance(Path(scene)), side, model.width, model.height)
    return SimulatedCamera(view, steered or light, sensor, still=still)
