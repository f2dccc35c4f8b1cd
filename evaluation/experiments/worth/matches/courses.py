"""The courses of the matches judge: which picture, in which light, how fast, and the frames that cameras take of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from evaluation.committed import PAINTINGS, REPORT_PAINTING, TUNING_PAINTING
from evaluation.experiments.worth.matches.scenes import (
    CANVAS,
    DISPARITY_PX,
    HEIGHT,
    WIDTH,
    MovingView,
    Radiance,
    TrueMotion,
    is_panorama,
    moving_view,
)
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.scenes.stills import DATA, PAINTERS, digest, stills
from evaluation.stage.camera import LIMITS, CameraResponse
from fake_camera.imaging import PIXEL_FORMATS, ImageSettings
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.pixels import Pixels
from imaging.response import ResponseFunction

LONGEST_S = LIMITS.max_time_us * 1e-6
# Motion of the image's middle between rendered instants: within 1 pixel where panoramas move faster, at their ends.
BLUR_STEP_PX = 0.75
DARK = 2.0**-8  # What a lens cap with a pinhole lets through: the other eye is 8 stops darker
DIRT_SIGMA_PX = 6.0  # Blur by dirt on the lens: no detail is left, only large shapes

_EYES: dict[str, Callable[[Radiance], Radiance]] = {
    "open": lambda seen: seen,
    "dark": lambda seen: seen * np.float32(DARK),
    "dirty": lambda seen: np.asarray(cv2.GaussianBlur(seen, (0, 0), DIRT_SIGMA_PX), np.float32),
    "dead": np.zeros_like,
}

DEFAULT_SENSOR = SensorModel(width=WIDTH, height=HEIGHT)
EYES = tuple(_EYES)  # States of the right camera; a dead one delivers frames without light


class Film:
    """The radiance of both cameras in exposures of any length; rendered on demand, once for everyone who exposes. An
    exposure of a moving camera is the mean over the instants that it spans, as in `evaluation.stage.rendering`. `view`:
    what is seen, per lux. `speed_px`: of the image, in its pixels per 1/60 s."""

    def __init__(self, view: MovingView, speed_px: float, lux: Callable[[int], float]) -> None:
        self._view, self._lux = view, lux
        self._instants = max(1, math.ceil(speed_px * RATE_HZ * LONGEST_S / BLUR_STEP_PX))
        self._sums: list[Radiance] = []
        self.frame = -1

    def go_to(self, frame: int) -> None:
        """Make this the present frame."""
        if frame != self.frame:
            self.frame, self._sums = frame, []

    def radiance(self, exposure_s: float) -> Radiance:
        """Mean radiance over an exposure of the present frame, (HEIGHT, CANVAS[0])."""
        part_s = LONGEST_S / self._instants
        whole = min(int(exposure_s / part_s), self._instants - 1)
        while len(self._sums) <= whole:
            at_s = self.frame / RATE_HZ + (len(self._sums) + 0.5) * part_s
            seen = self._view.radiance(at_s) * np.float32(self._lux(self.frame))
            self._sums.append(self._sums[-1] + seen if self._sums else seen)
        share = exposure_s / part_s - whole
        if whole == 0:
            return self._sums[0]
        scale = part_s / exposure_s
        mean = cv2.addWeighted(self._sums[whole - 1], (1 - share) * scale, self._sums[whole], share * scale, 0.0)
        return np.asarray(mean, np.float32)

    def truth(self, first: tuple[int, float], second: tuple[int, float]) -> TrueMotion:
        """The motion between two left frames (number, exposure time in us), each at the middle of its exposure."""
        middles = [number / RATE_HZ + self._middle_s(time_us * 1e-6) for number, time_us in (first, second)]
        return TrueMotion(self._view.homography(*middles), self._view.model)

    def _middle_s(self, exposure_s: float) -> float:
        """When, after the start, the mean radiance was seen: short of a part, everything is seen at its middle."""
        return max(exposure_s, LONGEST_S / self._instants) / 2


@dataclass(frozen=True, slots=True)
class Eyes:
    """What the cameras of a rig are."""

    model: SensorModel = DEFAULT_SENSOR  # the sensor; its size is that of the view
    response: str = "linear"  # name of its response function
    pixel_format: str = "Mono8"  # "Mono8" or "Mono12"
    right: str = "open"  # state of the right camera, one of `EYES`


class MatchesRig:
    """Exposes the frames of a film; the noise of a frame is the same whatever its exposure."""

    def __init__(self, film: Film, eyes: Eyes, seed: int) -> None:
        self._film, self._eyes, self._seed = film, eyes, seed
        self._sensors = {camera: Sensor(eyes.model, 2 * seed + (camera == "right"), eyes.response) for camera in _SIDES}

    def expose(self, camera: CameraName, setting: ExposureSetting) -> Frame:
        """The frame that one camera takes of the film's present frame."""
        seen = self._film.radiance(setting.exposure_time_us * 1e-6)
        seen = seen[:, :WIDTH] if camera == "left" else _EYES[self._eyes.right](seen[:, DISPARITY_PX:])
        settings = ImageSettings(
            setting.exposure_time_us, setting.gain_db, 0.0, 1.0, self._eyes.pixel_format, 0, 0, WIDTH, HEIGHT, 1, 1
        )
        number = self._film.frame
        pixels: Pixels = self._sensors[camera].expose(seen, settings, self._seed * 100_000 + number)
        time_ns = round(number / RATE_HZ * 1e9)
        depth = PIXEL_FORMATS[self._eyes.pixel_format].bit_depth
        return Frame(pixels, depth, number, time_ns, time_ns, time_ns, setting)

    def take(self, setting: ExposureSetting) -> FrameSet:
        """The pair that both cameras take with one setting."""
        return FrameSet(self._film.frame, {camera: self.expose(camera, setting) for camera in _SIDES})


_SIDES: tuple[CameraName, CameraName] = ("left", "right")
assert CANVAS == (WIDTH + DISPARITY_PX, HEIGHT)


# Of the image, in pixels of the 360 wide frame per 1/60 s: 1, 6 and 20 of a frame 720 wide.
SPEEDS_PX = (0.5, 3.0, 10.0)
LUX = (2.0, 10.0, 50.0, 300.0, 2000.0)  # A street at night, a corridor, a living room, an office, shade outdoors
# A cellar, and a turn of 67 degrees a second: of the rig's cameras, and of those before panoramas.
DIM_LUX, TURN_PX, PANORAMA_TURN_PX = 5.0, 8.4, 3.5
STEP_FACTOR = 100.0
STEP_LUX = (2.0, 6.0, 20.0)  # The light on the dark side of a step
WARM_UP = 30  # Frames not scored: half a second to find an exposure from a sensible start
STEADY_FRAMES = 72
STEP_AT, STEP_FRAMES = 36, 84  # A step is scored with three pairs before it, and 0.8 s after it
PAN_FRAMES, PAN_SPEEDS_PX = 150, (5.0, 10.0)  # Over the width of a still, once to twice
EVERY = 2  # Odometry gets every second frame, 30 a second

SENSORS = {
    "default": Eyes(),
    "twice the read noise": Eyes(SensorModel(WIDTH, HEIGHT, read_noise_e=2 * DEFAULT_SENSOR.read_noise_e)),
    "a quarter of the full well": Eyes(SensorModel(WIDTH, HEIGHT, full_well_e=DEFAULT_SENSOR.full_well_e / 4)),
    "s-shaped response": Eyes(response="s_shaped"),
    "gamma response": Eyes(response="gamma"),
    "Mono12": Eyes(pixel_format="Mono12"),
    "right eye dark": Eyes(right="dark"),
    "right eye dirty": Eyes(right="dirty"),
    "right eye dead": Eyes(right="dead"),
}
"""A smaller well at the same converter: the system gain K rises as the well shrinks."""


@dataclass(frozen=True, slots=True)
class MatchesCourse:
    """One course, as plain data."""

    scene: str  # see `moving_view`
    lux: float  # the light; where it steps, on the dark side
    light: str  # "steady", "up" or "down"
    speed_px: float  # of the image: pixels of the 360 wide frame per 1/60 s
    sensor: str = "default"  # one of `SENSORS`
    delay_frames: int = 2  # from a decision to the frame that shows it
    seed: int = 0  # of the path
    sha256: str = ""  # of the picture's file
    # Whether the camera goes from one side of a still to the other and back, instead of along a circle.
    pan: bool = False

    @property
    def name(self) -> str:
        """Unique, for people to read."""
        picture = self.scene.rpartition("/")[2].removesuffix(".hdr")
        light = {
            "steady": f"{self.lux:g} lux",
            "up": f"{self.lux:g} to {self.lux * STEP_FACTOR:g} lux",
            "down": f"{self.lux * STEP_FACTOR:g} to {self.lux:g} lux",
        }[self.light]
        special = [self.sensor] * (self.sensor != "default") + [f"delay {self.delay_frames}"] * (self.delay_frames != 2)
        special += ["pan"] * self.pan
        return ", ".join([picture, light, f"{self.speed_px:g} px", *special])

    @property
    def kind(self) -> str:
        """What is special: "default", a sensor, a delay, a pan, or dim light and a turn."""
        if self.pan or self.lux == DIM_LUX:
            return "pan" if self.pan else "dim, turning"
        return self.sensor if self.delay_frames == 2 else f"delay {self.delay_frames}"

    @property
    def frames(self) -> int:
        """Number of frames."""
        if self.pan:
            return PAN_FRAMES
        return STEADY_FRAMES if self.light == "steady" else STEP_FRAMES

    @property
    def scored(self) -> list[int]:
        """The frames that odometry gets; each one and its successor are a pair."""
        return list(range(WARM_UP, self.frames, EVERY))

    @property
    def eyes(self) -> Eyes:
        """The cameras."""
        return SENSORS[self.sensor]

    @property
    def response(self) -> ResponseFunction:
        """The true response of the cameras, which policies are given."""
        if self.eyes.response == "linear":
            return ResponseFunction.linear()
        return CameraResponse(self.eyes.response).function

    def lux_at(self, frame: int) -> float:
        """Light in a frame."""
        bright = self.light != "steady" and (frame >= STEP_AT) == (self.light == "up")
        return self.lux * (STEP_FACTOR if bright else 1.0)

    def film(self) -> Film:
        """What the cameras see."""
        return Film(moving_view(self.scene, self.speed_px, self.seed, pan=self.pan), self.speed_px, self.lux_at)

    def plain(self) -> dict[str, Any]:
        """As a job's argument."""
        return asdict(self)


_PANORAMAS = {
    "tuning": ("apartment", "city", "hall", "lobby", "park", "warehouse"),
    "report": ("bridge", "forest", "lab", "night", "sunrise", "workshop"),
}

_LIGHTS = ("steady", "steady", "up", "steady", "steady", "down")


def _varied(scenes: list[str], first_seed: int) -> list[MatchesCourse]:
    """Each scene once; light and speed go round, so that all meet all."""
    courses = []
    for place, scene in enumerate(scenes):
        light = _LIGHTS[(place + place // 15) % len(_LIGHTS)]
        lux = LUX[(2 * place + place // 15) % len(LUX)] if light == "steady" else STEP_LUX[place // 6 % len(STEP_LUX)]
        # Lights repeat after 6 and speeds after 3 places: the shift keeps them from going together.
        speed = SPEEDS_PX[(place + place // 3) % len(SPEEDS_PX)]
        courses.append(MatchesCourse(scene, lux, light, speed, seed=first_seed + place, sha256=digest(scene)))
    return courses


def _pans(scenes: list[str], first_seed: int) -> list[MatchesCourse]:
    """From side to side of each still, slower and faster, in the light of rooms and outdoors."""
    return [
        MatchesCourse(
            scene, LUX[1 + place // 2 % 4], "steady", PAN_SPEEDS_PX[place % 2],
            seed=first_seed + place, sha256=digest(scene), pan=True,
        )
        for place, scene in enumerate(scenes)
    ]  # fmt: skip


def _dim(scenes: list[str], first_seed: int) -> list[MatchesCourse]:
    """Each scene in dim light, while the camera turns."""
    speeds = [PANORAMA_TURN_PX if is_panorama(scene) else TURN_PX for scene in scenes]
    return [
        MatchesCourse(scene, DIM_LUX, "steady", speed, seed=first_seed + place, sha256=digest(scene))
        for place, (scene, speed) in enumerate(zip(scenes, speeds, strict=True))
    ]


def _special(scenes: list[str], kinds: list[tuple[str, int]], first_seed: int) -> list[MatchesCourse]:
    """One course for each kind of camera (sensor, delay)."""
    courses = []
    for place, (sensor, delay) in enumerate(kinds):
        scene, light = scenes[place % len(scenes)], _LIGHTS[(place + 2) % 3]
        lux = STEP_LUX[place % 3] if light != "steady" else (6.0, 150.0)[place % 2]
        speed, seed = SPEEDS_PX[1 + place % 2], first_seed + place
        courses.append(MatchesCourse(scene, lux, light, speed, sensor, delay, seed, digest(scene)))
    return courses


_KINDS = [("twice the read noise", 2), ("right eye dark", 2), ("default", 1), ("default", 3)]
_REPORT_KINDS = [
    ("a quarter of the full well", 2), ("s-shaped response", 2), ("gamma response", 2), ("Mono12", 2),
    ("right eye dirty", 2), ("right eye dead", 2),
]  # fmt: skip


def courses(name: str) -> list[MatchesCourse]:
    """Those of the tuning or the report set, which share no picture: photographs, panoramas, and paintings."""
    first = {"tuning": TUNING_PAINTING, "report": REPORT_PAINTING}[name]
    painted = [f"{painter}:{first + place}" for place in range(PAINTINGS) for painter in PAINTERS]
    photographs = stills(name) or [f"{painter}:{first + PAINTINGS}" for painter in PAINTERS]
    panoramas = [scene for one in _PANORAMAS[name] if (DATA / (scene := f"hdri_1k_cc0/{one}.hdr")).exists()]
    # Twice, so that each kind has two scenes.
    kinds = _KINDS if name == "tuning" else 2 * [*_KINDS, *_REPORT_KINDS]
    return [
        *_varied([*photographs * 3, *panoramas, *painted], first),
        *_pans([*photographs, *painted], first),
        *_dim([*photographs, *panoramas, *painted], first),
        *_special([*photographs, *panoramas[::2]], kinds, first),
    ]


def quick(every: list[MatchesCourse]) -> list[MatchesCourse]:
    """Six of a set, spread over it."""
    return [every[place] for place in np.linspace(0, len(every) - 1, 6).round().astype(int)]
