"""Teaching a path and replaying it: every policy in its own loop, all seeing the same park at the same time."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arrays import Floats
from evaluation.experiments.teach.park import MAPS, REPLAYS, TEACHING, ParkPath, park
from evaluation.jobs.job import Plain
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import LIMITS, Entrant, Image, Radiance, SimulatedCamera, pair_of, time_first
from fake_camera.world.render.renderer import Renderer, Surface
from imaging.exposure import ExposureSetting
from imaging.frames import FrameSet
from navigation.views.features import Features, OrbPyramid, Part
from navigation.views.registration import register, vote

BRIGHTNESS = 0.5  # The mean that the paper's policies hold, and to which its operator sets the fixed exposure (MH 4.2)


def at_half(camera: SimulatedCamera, radiance: Radiance, *, top_only: bool = False) -> ExposureSetting:
    """The setting whose image, or the top half of it, has a mean of one half, as far as the limits allow."""
    low, high = LIMITS.darkest.level, LIMITS.brightest.level
    rows = CAMERA.height // 2 if top_only else CAMERA.height
    for _ in range(12):
        level = (low + high) / 2
        if camera.expose(radiance, time_first(level), 0)[:rows].mean() < BRIGHTNESS * 255:
            low = level
        else:
            high = level
    return time_first((low + high) / 2)


GRID_PX = 18  # Spacing of the image points at which the true shift is looked up


class TrueShifts:
    """The shift that would win the vote if everything upright were matched correctly, from the park's geometry. The
    ground is left out: its displacement depends on its distance, and says nothing about the heading."""

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        self._corners = np.array([surface.corner for surface in surfaces])
        self._edges = np.array([[surface.edge_u, surface.edge_v] for surface in surfaces])
        self._upright = np.array([abs(surface.edge_v[2]) > 1e-9 for surface in surfaces])
        half_x, half_y = (CAMERA.width - 1) / 2, (CAMERA.height - 1) / 2
        x, y = np.meshgrid(np.arange(0, CAMERA.width, GRID_PX), np.arange(0, CAMERA.height, GRID_PX))
        self._pixels = x.ravel().astype(np.float64)
        across, down = (self._pixels - half_x) / CAMERA.focal_px, (y.ravel() - half_y) / CAMERA.focal_px
        self._rays = np.stack([across, down, np.ones(x.size)], axis=1)

    def shift(self, taught: Floats, seen: Floats) -> float:
        """True shift (pixels) of the image from pose `seen` against the one from pose `taught`; NaN for none."""
        points = self._points(taught)
        local = (points - seen[:3, 3]) @ seen[:3, :3]
        with np.errstate(invalid="ignore", divide="ignore"):
            column, row = (
                CAMERA.focal_px * local[:, axis] / local[:, 2] + (size - 1) / 2
                for axis, size in ((0, CAMERA.width), (1, CAMERA.height))
            )
        visible = (local[:, 2] > 0) & (column >= 0) & (column < CAMERA.width) & (row >= 0) & (row < CAMERA.height)
        winner = vote((column - self._pixels)[visible]).shift_px
        return math.nan if winner is None else winner

    def _points(self, pose: Floats) -> Floats:
        """World point seen at each point of the grid, shape (points, 3); NaN where nothing upright is seen."""
        rays = self._rays @ pose[:3, :3].T
        nearest = np.full(len(rays), np.inf)
        upright = np.zeros(len(rays), bool)
        to_corners = self._corners - pose[:3, 3]
        for to_corner, (edge_u, edge_v), is_upright in zip(to_corners, self._edges, self._upright, strict=True):
            normal = np.cross(edge_v, edge_u)
            if normal @ to_corner >= 0:
                continue  # seen from behind
            with np.errstate(divide="ignore"):
                depth = (normal @ to_corner) / (rays @ normal)
            across = rays * depth[:, None] - to_corner
            a, b = across @ edge_u / (edge_u @ edge_u), across @ edge_v / (edge_v @ edge_v)
            hit = (depth > 0) & (depth < nearest) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
            nearest[hit] = depth[hit]
            upright[hit] = is_upright
        return np.where(upright[:, None], rays * nearest[:, None] + pose[:3, 3], np.nan)


# The paper's three, and two newer ones.
POLICIES = ("majer2018-standard", "majer2018-full", "majer2018-fixed", "begin2022", DEFAULT_POLICY)
RATE_HZ = 30.0
DELAY_FRAMES = 2  # A decision on one frame applies from this many frames later
# 640 images in a drive (658 in the paper), and frames from one image to the next, at about 0.3 m/s.
IMAGES_PER_MAP, FRAMES_PER_IMAGE = 8, 5
ENTRANTS = tuple(Entrant.of(name, DELAY_FRAMES) for name in POLICIES)
STILL_FRAMES, FIRST_FRAMES = 10, 40  # Frames at rest before a map is taught, and before a drive begins

# The policy that taught the map (None: the replaying one), and where features are looked for.
WAYS: dict[str, tuple[str | None, Part]] = {
    "as the paper": ("majer2018-standard", "top half"),
    "each its own map": (None, "top half"),
    "features everywhere": ("majer2018-standard", "whole image"),
}


class ExposingRobot:
    """Carries all entrants: each exposes the same view with its own setting. Images are not blurred: the robot is slow,
    it moves less than a pixel in 7.5 ms. `first`: radiance of the first frame, from which the operator sets the
    exposure that all start with and `fixed` keeps."""

    def __init__(
        self, camera: SimulatedCamera, first: Radiance, entrants: Sequence[Entrant] = ENTRANTS, rate_hz: float = RATE_HZ
    ) -> None:
        self._camera, self._rate_hz = camera, rate_hz
        start = at_half(camera, first)
        self.loops = {one.name: one.enter(start) for one in entrants}
        self._frame = 0
        for _ in range(FIRST_FRAMES):
            self.step(first)

    def step(self, radiance: Radiance) -> dict[str, Image]:
        """One frame, which each entrant takes with its own exposure and decides on; returns the images by entrant."""

        def take(setting: ExposureSetting) -> FrameSet:
            image = self._camera.expose(radiance, setting, self._frame)
            return pair_of({"left": image}, setting, self._frame, self._frame / self._rate_hz)

        images = {name: loop.step(take).reference.grey8() for name, loop in self.loops.items()}
        self._frame += 1
        return images


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a path: how many maps, from which one on, and who drives there."""

    path: ParkPath
    maps: int
    first: int = 0
    entrants: Sequence[Entrant] = ENTRANTS


def taught_maps(stretch: Stretch, renderer: Renderer, camera: SimulatedCamera) -> dict[Part, dict[str, list[Features]]]:
    """Features of each map of a stretch, by part of the image and entrant. The robot rests at each before its image is
    taken."""
    detector = OrbPyramid()
    taught: dict[Part, dict[str, list[Features]]] = {
        "top half": {one.name: [] for one in stretch.entrants},
        "whole image": {one.name: [] for one in stretch.entrants},
    }
    robot: ExposingRobot | None = None
    for index in range(stretch.first, stretch.first + stretch.maps):
        radiance = renderer.render(stretch.path.taught(index)[None], TEACHING.lux(0.0))
        robot = robot or ExposingRobot(camera, radiance, stretch.entrants)
        for _ in range(STILL_FRAMES):
            images = robot.step(radiance)
        for part, features in taught.items():
            for name, image in images.items():
                features[name].append(detector.find(image, part))
    return taught


def frames(stretch: Stretch, light: str) -> Iterator[tuple[int, Floats, float]]:
    """The frames of one replay: number, pose and light (lux)."""
    daylight, number = REPLAYS[light], 1 + list(REPLAYS).index(light)
    for frame in range(stretch.maps * IMAGES_PER_MAP * FRAMES_PER_IMAGE):
        distance = (stretch.first + frame / (IMAGES_PER_MAP * FRAMES_PER_IMAGE) - 0.5) * stretch.path.spacing_m
        progress = frame / (MAPS * IMAGES_PER_MAP * FRAMES_PER_IMAGE)
        yield frame, stretch.path.repeated(number, distance), daylight.lux(progress)


def image_of(frame: int) -> int | None:
    """The map that the image taken in a frame is registered with, from 0; None for a frame without an image."""
    return frame // (IMAGES_PER_MAP * FRAMES_PER_IMAGE) if frame % FRAMES_PER_IMAGE == FRAMES_PER_IMAGE - 1 else None


def replayed(
    stretch: Stretch, renderer: Renderer, camera: SimulatedCamera, light: str
) -> Iterator[tuple[int, Floats, dict[str, Image], ExposingRobot]]:
    """The images of one replay: the nearest map (from 0), pose, image by entrant, and the robot."""
    robot: ExposingRobot | None = None
    for frame, pose, lux in frames(stretch, light):
        radiance = renderer.render(pose[None], lux)
        robot = robot or ExposingRobot(camera, radiance, stretch.entrants)
        images = robot.step(radiance)
        index = image_of(frame)
        if index is not None:
            yield index, pose, images, robot


def measure(seed: int, tilt_deg: float, light: str, maps: int) -> Plain:
    """Teach a path and replay it in another light. `tilt_deg`: how far the camera looks up. `light`: of the replay, one
    of `REPLAYS`. `maps`: how many of the 80 maps, starting with the first. Returns `map` and true `shift` (pixels) of
    each registration; by way and policy, the `shifts` found (None for none) and their `votes`; `looks` of each image by
    policy: exposure level, mean of the top half and of the whole (0 to 1), share of saturated pixels. `views`: one
    image by policy from the middle of the drive, a small JPEG in base 64."""
    path = ParkPath(seed, tilt_deg)
    stretch, surfaces = Stretch(path, maps), park(seed, TEACHING)
    truth = TrueShifts(surfaces)
    taught = taught_maps(stretch, Renderer(surfaces, CAMERA), SimulatedCamera(2 * seed, 2 * seed))
    detector = OrbPyramid()
    where: list[int] = []
    shift: list[float] = []
    shifts: dict[str, dict[str, list[float | None]]] = {way: {name: [] for name in POLICIES} for way in WAYS}
    votes: dict[str, dict[str, list[int]]] = {way: {name: [] for name in POLICIES} for way in WAYS}
    looks: dict[str, list[list[float]]] = {name: [] for name in POLICIES}
    views: dict[str, str] = {}
    renderer, camera = Renderer(park(seed, REPLAYS[light]), CAMERA), SimulatedCamera(2 * seed + 1, 2 * seed + 1)
    for index, pose, images, robot in replayed(stretch, renderer, camera, light):
        if len(where) == maps * IMAGES_PER_MAP // 2:
            views = {name: _small(image) for name, image in images.items()}
        where.append(index)
        shift.append(truth.shift(path.taught(index), pose))
        for name, image in images.items():
            looks[name].append([robot.loops[name].settings[-1].level, *_look(image)])
            seen: dict[Part, Features] = {part: detector.find(image, part) for part in taught}
            for way, (teacher, part) in WAYS.items():
                won = register(taught[part][teacher or name][index], seen[part]).vote
                shifts[way][name].append(won.shift_px)
                votes[way][name].append(won.votes)
    return {"map": where, "shift": shift, "shifts": shifts, "votes": votes, "looks": looks, "views": views}


def _look(image: Image) -> tuple[float, float, float]:
    """Means of the top half and of the whole, and the saturated share."""
    upper = image[: image.shape[0] // 2]
    return float(upper.mean()) / 255, float(image.mean()) / 255, float((image == 255).mean())


def _small(image: Image) -> str:
    small = cv2.resize(image, (288, 216), interpolation=cv2.INTER_AREA)
    return base64.b64encode(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()).decode()


OFFSETS = tuple(range(-4, 5))  # Stops from the exposure that holds the top half at 0.5
AHEAD = 0.2  # Where a view is replayed: this share of the way from its map to the next


def measure_sweep(seed: int, tilt_deg: float, light: str, maps: int) -> Plain:
    """Register one view near each map at all offsets. The map is taught with the top half at 0.5. Arguments as those of
    `replay.measure`. Returns for each map: `errors` (pixels, None where no shift was found) and `votes` at each of the
    `offsets`, and the offset at which the `whole` image has a mean of 0.5."""
    path, detector, camera = ParkPath(seed, tilt_deg), OrbPyramid(), SimulatedCamera(2 * seed, 2 * seed)
    surfaces = park(seed, TEACHING)
    truth, before = TrueShifts(surfaces), Renderer(surfaces, CAMERA)
    after, number = Renderer(park(seed, REPLAYS[light]), CAMERA), 1 + list(REPLAYS).index(light)
    errors: list[list[float | None]] = []
    votes: list[list[int]] = []
    whole: list[float] = []
    for index in range(maps):
        radiance = before.render(path.taught(index)[None], TEACHING.lux(0.0))
        taught = detector.find(camera.expose(radiance, at_half(camera, radiance, top_only=True), 2 * index), "top half")
        pose = path.repeated(number, (index + AHEAD) * path.spacing_m)
        shift = truth.shift(path.taught(index), pose)
        radiance = after.render(pose[None], REPLAYS[light].lux(index / maps))
        middle = at_half(camera, radiance, top_only=True).level
        whole.append(at_half(camera, radiance).level - middle)
        won = []
        for offset in OFFSETS:
            image = camera.expose(radiance, time_first(middle + offset), 2 * index + 1)
            won.append(register(taught, detector.find(image, "top half")).vote)
        errors.append([None if vote.shift_px is None else abs(vote.shift_px - shift) for vote in won])
        votes.append([vote.votes for vote in won])
    return {"offsets": list(OFFSETS), "errors": errors, "votes": votes, "whole": whole}
