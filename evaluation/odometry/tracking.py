"""Policies in closed loop through a lap of a room, side by side, each with its own odometry."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import groupby
from typing import Any, Literal

import numpy as np

from evaluation.arrays import Floats, Floats32
from evaluation.odometry.stereo import StereoOdometry, images, relative_errors_mm
from evaluation.scenes.scenarios import Course, no_turn, steady
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import DelayedLoop, Entrant
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import Stage
from fake_camera.world.render.renderer import Renderer, Surface
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.scene.room import WINDOW_RADIANCE, furnished_room
from fake_camera.world.sensor import DEFAULT_F_NUMBER
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting
from imaging.frames import FrameSet

EVERY = 2  # Odometry gets every second pair, 30 a second: 20 mm then take at least 7 pairs
FAILED_PAIRS = 5  # After this many lost pairs in a row, a sixth of a second, tracking is lost and the run has failed


@dataclass(slots=True, eq=False)
class TrackedRun:
    """How one entrant did; `estimate`, `lost` and `truth` have an entry for each pair that odometry got."""

    entrant: Entrant
    delayed: DelayedLoop
    odometry: StereoOdometry
    estimate: list[Floats] = field(default_factory=list)
    lost: list[bool] = field(default_factory=list)
    truth: list[Floats] = field(default_factory=list)

    def errors_mm(self) -> list[float]:
        """Translation RPE of each sub-trajectory; guesses for lost pairs count like any pose."""
        return relative_errors_mm(self.truth, self.estimate)


def track_entrants(
    stage: Stage,
    entrants: Sequence[Entrant],
    odometry: Callable[[], StereoOdometry],
    frames: int,
    look: Callable[[int, FrameSet], None] = lambda _entrant, _pair: None,
) -> list[TrackedRun]:
    """Take all entrants through the first frames of a course, each starting from the best exposure of the first.
    `frames`: how many, at 60 a second. `look`: called with the index of the entrant and each pair that odometry
    gets."""
    start = best_start(Oracle(stage))
    runs = [TrackedRun(entrant, entrant.enter(start), odometry()) for entrant in entrants]
    for frame in range(frames):
        stage.go_to(frame)
        for number, one in enumerate(runs):
            pair = one.delayed.step(stage.take)
            if frame % EVERY == 0:
                tracked = one.odometry.track(*images(pair))
                one.estimate.append(tracked.pose)
                one.lost.append(tracked.lost)
                one.truth.append(true_pose(stage, pair.reference.setting))
                look(number, pair)
    return runs


def outcome(one: TrackedRun) -> dict[str, Any]:
    """The figures of one run, in plain JSON. rpe_mm: mean over sub-trajectories, guesses for lost pairs included;
    lost_share, failed; metric: median M_g; truth, path: the true and the estimated path from above, in the frame of the
    first camera, mm; times_us, gains_db, metrics: at each pair that odometry got."""
    first = np.linalg.inv(one.truth[0])
    settings = one.delayed.settings[::EVERY]
    metrics = one.delayed.metrics
    return {
        "name": one.entrant.name,
        "rpe_mm": float(np.mean(one.errors_mm())),
        "lost_share": float(np.mean(one.lost)),
        "failed": lost_for_good(one.lost),
        "metric": float(np.median(metrics)),
        "truth": [_from_above(first @ pose) for pose in one.truth],
        "path": [_from_above(pose) for pose in one.estimate],
        "times_us": [round(setting.exposure_time_us, 1) for setting in settings],
        "gains_db": [round(setting.gain_db, 2) for setting in settings],
        "metrics": [round(metric, 4) for metric in metrics[::EVERY]],
    }


def lost_for_good(lost: Sequence[bool]) -> bool:
    """Whether enough pairs in a row were lost for the run to have failed."""
    return any(gone and len(list(together)) >= FAILED_PAIRS for gone, together in groupby(lost))


def _from_above(pose: Floats) -> list[float]:
    return [round(1e3 * float(pose[0, 3]), 2), round(1e3 * float(pose[2, 3]), 2)]


def true_pose(stage: Stage, setting: ExposureSetting) -> Floats:
    """Where the left camera is in the middle of an exposure of the present frame."""
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    return view.pose(stage.start_s(stage.frame) + setting.exposure_time_us / 2e6)


# Scenarios (a) and (b) of Begin & Hunter's section 3.3, a darker (b), and the light of section 3.1.
Light = Literal["uneven", "low", "faint", "even"]

# Mean light on the walls of the dim and the bright part of the room.
LUX: dict[Light, tuple[float, float]] = {
    "uneven": (1.0, 217.0),
    "low": (3.0, 3.0),
    "faint": (0.5, 0.5),
    "even": (20.0, 20.0),
}

PAINT = 0.9  # Reflectance of the window: it is covered by a poster, so that all light is the room's
ROOM_SCALE = 0.6  # The room is scaled down, so that things are 0.2 to 2 m away; the paper's were 0.2 to 2.5 m away
# The bright part of the room as seen from its middle, and the angle over which its light fades (radians).
BRIGHT_HALF_ANGLE, FADE = 0.5, 0.4
PERIOD_S, YAW_SWING = 15.0, 0.9  # At most 86 mm and 89 degrees a second; the paper's table moved at up to 100 of both


def odometry_stage(light: Light, room: int, seed: int, repeat: int, lens_f_number: float = DEFAULT_F_NUMBER) -> Stage:
    """One course. `seed`: of the heading of the lap through it. `repeat`: number of the repeat of the same lap; decides
    the noise."""
    path = lap(seed)
    # At its turning point the camera looks into the middle of the bright part.
    surfaces = _lit(room, LUX[light], path.heading_rad + math.pi / 6 + YAW_SWING)
    renderer = Renderer(surfaces, CAMERA)
    left, right = (RoomView(renderer, path, camera) for camera in ("left", "right"))
    course = Course(steady(1.0), no_turn, 0)  # the room has its light baked in
    noise_seed = 1000 * (1000 * room + seed) + repeat
    return Stage({"left": left, "right": right}, course, noise_seed, lens_f_number=lens_f_number)


def lap(seed: int, period_s: float = PERIOD_S) -> CameraPath:
    """The path of the cameras: from rest, at full speed after two seconds; a lap then takes `period_s`."""
    heading_rad = float(np.random.default_rng([seed, 41]).uniform(-math.pi, math.pi))
    standard = CameraPath()
    return replace(
        standard, period_s=period_s, semi_axis_x_m=ROOM_SCALE * standard.semi_axis_x_m,
        semi_axis_y_m=ROOM_SCALE * standard.semi_axis_y_m, height_m=ROOM_SCALE * standard.height_m,
        heading_rad=heading_rad, yaw_swing_rad=YAW_SWING,
    )  # fmt: skip


@lru_cache(maxsize=1)
def _furnished(room: int) -> list[Surface]:
    return [
        replace(s, corner=ROOM_SCALE * s.corner, edge_u=ROOM_SCALE * s.edge_u, edge_v=ROOM_SCALE * s.edge_v)
        for s in furnished_room(room)
    ]


@lru_cache(maxsize=1)
def _lit(room: int, lux: tuple[float, float], bright_rad: float) -> list[Surface]:
    """The room with light on it: `lux[1]` around a bearing from its middle, `lux[0]` away from it."""
    surfaces = _furnished(room)
    painted = [
        surface if surface.follows_light
        else replace(surface, pattern=surface.pattern * np.float32(PAINT / WINDOW_RADIANCE), follows_light=True)
        for surface in surfaces
    ]  # fmt: skip
    return [replace(s, pattern=s.pattern * illumination(s, lux, bright_rad)) for s in painted]


def illumination(surface: Surface, lux: tuple[float, float], bright_rad: float) -> Floats32:
    """Light on every texel of a surface, shape (rows, columns), by its bearing from the middle of the room. `lux[1]`
    around the bearing `bright_rad`, `lux[0]` away from it."""
    rows, columns = surface.pattern.shape
    u, v = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
    x, y = (
        surface.corner[axis] + surface.edge_u[axis] * u[None] + surface.edge_v[axis] * v[:, None] for axis in (0, 1)
    )
    off = np.abs(np.angle(np.exp(1j * (np.arctan2(y, x) - bright_rad))))
    fade = np.clip((off - BRIGHT_HALF_ANGLE) / FADE, 0.0, 1.0)
    fade = fade * fade * (3.0 - 2.0 * fade)
    stops = math.log2(lux[1]) * (1.0 - fade) + math.log2(lux[0]) * fade
    return np.asarray(np.exp2(stops), np.float32)
