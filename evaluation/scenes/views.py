"""What the cameras look at: rooms with printed or natural texture, painted stills, and pictures of real radiance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import cv2
import numpy as np

from evaluation.arrays import Floats, Floats32
from evaluation.scenes.stills import PAINTERS, Still, leaves, painting
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.scene.panorama import load_radiance
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.scene.room import LAMP_RADIANCE, furnished_room
from fake_camera.world.scene.shapes import block, from_below, level, upright
from fake_camera.world.scene.textures import Pattern, lampshade
from fake_camera.world.simulation import RoomView
from imaging.frames import CameraName

CAMERA = Pinhole()
# Where the camera looks at a time (s): an angle in radians from the heading of the scene, positive to the left.
Gaze = Callable[[float], float]
WINDOW_HEADING_RAD = -math.pi / 2  # The room's window is in its south wall
NEAR_WINDOW_M = (-0.2, -0.75)  # From here the window fills the view, with no furniture in between
OPENING = (600, 860)  # Height and width (pixels) of the window in stills: larger than the view
OUTDOORS_LUX = 1000.0  # Light outside the window of stills, 8 stops above the 4 lux inside
DISPARITY_PX = 24.0  # Of stills, where everything is at one distance
# Width and height of stills (pixels): room for the widest pan, one radian to either side, plus the view.
STILL_SIZE = (3000, 700)


@dataclass(frozen=True, slots=True)
class GazePath(CameraPath):
    """A camera that stays at one place in the room, looks where `gaze` says, and sways 10 cm as it turns."""

    gaze: Gaze = lambda _: 0.0
    place_m: tuple[float, float] = (0.0, 0.0)
    heading_rad: float = 0.0

    def pose(self, time_s: float) -> Floats:
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

    def radiance(self, times_s: Floats, lux: float) -> Floats32:
        """Mean radiance over the instants in lux times reflectance, shape (height, width); affine in `lux`."""


class StillView:
    """One camera's view of a still; a `Scene`. `interior`: radiance per lux of light, float32, (rows, columns).
    `outdoors`: radiance that does not follow the light, same shape, or None. `gaze`: where the camera looks; 0 is the
    middle of the still."""

    def __init__(self, interior: Floats32, outdoors: Floats32 | None, gaze: Gaze, camera: CameraName) -> None:
        self._interior, self._outdoors, self._gaze = interior, outdoors, gaze
        self._shift_px = DISPARITY_PX if camera == "right" else 0.0

    def image_shift_px(self, start_s: float, end_s: float) -> float:
        """How far the image moves between two instants, in pixels."""
        return CAMERA.focal_px * abs(self._gaze(end_s) - self._gaze(start_s))

    def radiance(self, times_s: Floats, lux: float) -> Floats32:
        """Mean radiance over the instants in lux times reflectance, shape (height, width); affine in `lux`."""
        total = np.zeros((CAMERA.height, CAMERA.width), np.float32)
        for time_s in times_s:
            total += self._at(self._interior, float(time_s)) * np.float32(lux)
            if self._outdoors is not None:
                total += self._at(self._outdoors, float(time_s))
        total /= np.float32(len(times_s))
        return total

    def _at(self, still: Floats32, time_s: float) -> Floats32:
        rows, columns = still.shape
        centre = (columns / 2 - CAMERA.focal_px * self._gaze(time_s) + self._shift_px, rows / 2)
        return np.asarray(cv2.getRectSubPix(still, (CAMERA.width, CAMERA.height), centre), np.float32)


def build_views(scene: str, seed: int, gaze: Gaze, at_window: bool) -> dict[CameraName, Scene]:
    """Both cameras' views. `scene`: "room", a painter of `evaluation.scenes.stills`, or the path of a Radiance .hdr
    file. `seed`: decides the room or the painting, and where the camera looks first. `at_window`: whether angle 0 is a
    window, brighter than everything else when the light is dim."""
    rng = np.random.default_rng([seed, 77])
    turn = float(rng.uniform(-1.0, 1.0))
    if scene == "room":
        # The demo's lap stays clear of the furniture, and so does every place inside it.
        bearing = rng.uniform(0, 2 * math.pi)
        place = NEAR_WINDOW_M if at_window else (0.3 * math.cos(bearing), 0.2 * math.sin(bearing))
        heading = WINDOW_HEADING_RAD if at_window else turn * math.pi
        path = GazePath(gaze=gaze, place_m=place, heading_rad=heading)
        renderer = Renderer(furnished_room(seed), CAMERA)
        return {camera: RoomView(renderer, path, camera) for camera in ("left", "right")}
    interior, outdoors = _still(scene, seed, at_window)
    start = 0.0 if at_window else 0.35 * turn

    def turned(time_s: float) -> float:
        return start + gaze(time_s)

    return {camera: StillView(interior, outdoors, turned, camera) for camera in ("left", "right")}


def _still(scene: str, seed: int, at_window: bool) -> tuple[Floats32, Floats32 | None]:
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


def _wide(picture: Floats32) -> Floats32:
    """A picture enlarged to the height of stills and mirrored at its sides until it is wide enough."""
    scale = max(1.0, STILL_SIZE[1] / picture.shape[0])
    size = (math.ceil(picture.shape[1] * scale), math.ceil(picture.shape[0] * scale))
    large = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA)
    margin = max(0, STILL_SIZE[0] - large.shape[1]) // 2 + 1
    return np.maximum(cv2.copyMakeBorder(large, 0, 0, margin, margin, cv2.BORDER_REFLECT), np.float32(0.0))


Feature = Literal["plain", "window", "lamps"]  # What there is beside walls and cartons
# East to west, north to south, floor to ceiling: the furnished room at the scale of `evaluation.odometry.tracking`.
LENGTH_M, WIDTH_M, HEIGHT_M = 3.0, 2.4, 1.32
TEXELS_PER_M = 680.0  # About one texel per pixel at 1.2 m
LEVEL_TEXELS_PER_M = 340.0  # Of floor and ceiling, which are seen at a slant
# Largest size of the pieces into which pictures are cut (texels): no picture repeats over the whole of a wall.
TILE = 360
DARKEST, BRIGHTEST = 0.03, 0.9  # Reflectance: black ink and white paper
# Between the 1st and the 99th percentile of a wall: all that a surface can have, or plaster and faded paint.
HIGH_STOPS, LOW_STOPS = math.log2(BRIGHTEST / DARKEST), 1.7
CARTONS = 8  # So many that every view has something near: before a bare wall, turning and moving sideways look alike
# Width and height of the window, its height above the floor, and its distance from the middle of the room. It is a bay
# with a dark frame, so that it fits before any bearing.
WINDOW_M, SILL_M, WINDOW_AWAY_M = (0.55, 0.6), 0.15, 1.0
_FRAME = 0.002  # Share of the window's light that its frame shows


def natural_room(pictures: Sequence[Still], seed: int, feature: Feature, bearing_rad: float) -> list[Surface]:
    """The surfaces of a room in even light; the seed decides pieces, contrasts and the places of cartons. Cartons leave
    the middle free: at least 0.15 m to either camera on the path of `odometry.tracking.lap`, where the odometry begins
    to look. `pictures`: radiance, float32, (rows, columns); at least one. `feature`: also there: a window with daylight
    that does not follow the room's light, or two lamps. `bearing_rad`: where that is, as seen from the middle."""
    rng = np.random.default_rng([seed, 51])
    papers = [_paper(picture, HIGH_STOPS) for picture in pictures], [_paper(picture, LOW_STOPS) for picture in pictures]
    surfaces = [*_shell(rng, papers), *_cartons(rng, papers)]
    if feature == "window":
        surfaces.append(_window(rng, pictures, bearing_rad))
    if feature == "lamps":
        surfaces += _lamps(bearing_rad)
    return surfaces


def _paper(picture: Still, stops: float) -> Pattern:
    """A picture as a surface: the logarithm of its radiance takes up a span around the middle grey, shape as given."""
    logs = np.log2(np.maximum(picture, np.float32(1e-6)))
    low, high = np.percentile(logs, (1.0, 99.0))
    middle = (math.log2(DARKEST) + math.log2(BRIGHTEST)) / 2
    share = (logs - low) / max(float(high - low), 1e-3) - 0.5
    return np.asarray(np.exp2(middle + stops * share).clip(DARKEST, BRIGHTEST), np.float32)


def _papered(rng: np.random.Generator, papers: Sequence[Pattern], rows: int, columns: int) -> Pattern:
    """A surface covered with pieces of pictures at their own resolution, mirrored at random."""
    down, across = math.ceil(rows / TILE), math.ceil(columns / TILE)
    surface = np.empty((rows, columns), np.float32)
    for top in np.linspace(0, rows, down + 1).astype(int)[:-1]:
        for left in np.linspace(0, columns, across + 1).astype(int)[:-1]:
            part = surface[top : top + TILE, left : left + TILE]
            part[:] = _piece(rng, papers[int(rng.integers(len(papers)))], *part.shape)
    return surface


def _piece(rng: np.random.Generator, paper: Pattern, rows: int, columns: int) -> Pattern:
    top, left = (
        int(rng.integers(size - wanted + 1)) for size, wanted in zip(paper.shape, (rows, columns), strict=True)
    )
    piece = paper[top : top + rows, left : left + columns]
    return piece[:, ::-1] if rng.random() < 0.5 else piece


def _shell(rng: np.random.Generator, papers: tuple[list[Pattern], list[Pattern]]) -> list[Surface]:
    """Four walls, by turns of high and low contrast, so that few views show nothing else than low; floor, ceiling."""
    surfaces = []
    first = int(rng.integers(2))
    for number, facing in enumerate((0.0, 90.0, 180.0, 270.0)):
        width, distance = (WIDTH_M, LENGTH_M / 2) if facing % 180.0 == 0.0 else (LENGTH_M, WIDTH_M / 2)
        angle = math.radians(facing)
        wall = _papered(rng, papers[(number + first) % 2], round(HEIGHT_M * TEXELS_PER_M), round(width * TEXELS_PER_M))
        centre = np.array([math.cos(angle), math.sin(angle)]) * distance
        surfaces.append(upright(centre, facing, width, (0.0, HEIGHT_M), wall))
    rows, columns = (round(size * LEVEL_TEXELS_PER_M) for size in (WIDTH_M, LENGTH_M))
    floor, ceiling = (_papered(rng, papers[1], rows, columns) for _ in range(2))
    middle, size = np.zeros(2), (LENGTH_M, WIDTH_M)
    return [*surfaces, level(middle, size, 0.0, 0.0, floor), from_below(level(middle, size, 0.0, HEIGHT_M, ceiling))]


def _cartons(rng: np.random.Generator, papers: tuple[list[Pattern], list[Pattern]]) -> list[Surface]:
    """Cartons before the walls, for parallax, by turns of high and low contrast."""
    surfaces = []
    for number, bearing in enumerate(np.arange(CARTONS) * 360.0 / CARTONS + rng.uniform(-12.0, 12.0, CARTONS)):
        angle, distance = math.radians(float(bearing)), float(rng.uniform(0.6, 0.8))
        size = (float(rng.uniform(0.15, 0.22)), float(rng.uniform(0.15, 0.22)))
        height = float(rng.uniform(0.27, 0.5))
        cameras = [
            _papered(rng, papers[number % 2], round(height * TEXELS_PER_M), round(width * TEXELS_PER_M))
            for width in (size[1], size[0], size[1], size[0])
        ]
        top = _papered(rng, papers[1], 64, 64)
        centre = np.array([math.cos(angle), math.sin(angle)]) * distance
        surfaces += block(centre, size, float(rng.uniform(0.0, 90.0)), (0.0, height), [*cameras, top])
    return surfaces


def _window(rng: np.random.Generator, pictures: Sequence[Still], bearing_rad: float) -> Surface:
    """A window; outside is a picture in daylight."""
    width, height = WINDOW_M
    view = _papered(rng, pictures, round(height * TEXELS_PER_M), round(width * TEXELS_PER_M))
    bar = round(0.02 * TEXELS_PER_M)
    for axis, bars in ((0, 2), (1, 3)):
        for middle in np.linspace(0, view.shape[axis], bars + 1).astype(int):
            at = slice(max(middle - bar, 0), middle + bar)
            view[(at, slice(None)) if axis == 0 else (slice(None), at)] *= np.float32(_FRAME)
    centre = WINDOW_AWAY_M * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    window = upright(centre, math.degrees(bearing_rad), width, (SILL_M, SILL_M + height), view)
    return replace(window, pattern=window.pattern * np.float32(OUTDOORS_LUX), follows_light=False)


def _lamps(bearing_rad: float) -> list[Surface]:
    """Two lamps on poles, one on either side of a bearing."""
    surfaces = []
    for camera in (-0.3, 0.3):
        at: Floats = 0.85 * np.array([math.cos(bearing_rad + camera), math.sin(bearing_rad + camera)])
        shade = [lampshade(128, 128) * np.float32(LAMP_RADIANCE)] * 4
        surfaces += block(at, (0.12, 0.12), 20.0, (0.4, 0.55), shade)
        surfaces += block(at, (0.02, 0.02), 20.0, (0.0, 0.4), [np.full((64, 8), 0.25, np.float32)] * 4)
    return surfaces
