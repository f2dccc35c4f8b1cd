"""Simulated sweeps of a camera, sound and spoilt, and whether calibration states their error honestly."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from calibration.document import Verdict
from calibration.response.file import SIGMAS, Origin, ResponseSolution
from calibration.response.result import calibrate
from calibration.sweep import Shot, Sweep, SweepPlan
from evaluation.arrays import Floats
from fake_camera.world.lighting import Change, Flicker, LightScript
from imaging.exposure import ExposureLimits, ExposureSetting, linear_gain
from imaging.pixels import Pixels
from imaging.response import ResponseFunction

Processing = Literal["raw", "jpeg 75", "jpeg 85", "jpeg 95", "median", "bilateral", "nlm", "colour"]
# Those that leave no noise of photons; "colour" is three channels that mix, as JPEG of one of those qualities.
PROCESSINGS: tuple[Processing, ...] = ("jpeg 75", "jpeg 85", "jpeg 95", "median", "bilateral", "nlm", "colour")
Process = Callable[[Pixels], Pixels]
GREEN = 1


def process_of(processing: Processing, rng: np.random.Generator) -> Process:
    """What is done to every image of a sweep, one channel or three; its strength is drawn once."""
    match processing:
        case "raw":
            return lambda image: image
        case "median":
            return lambda image: cv2.medianBlur(image, 3).astype(np.uint8)
        case "bilateral":
            colour, space = float(rng.uniform(8.0, 40.0)), float(rng.uniform(1.0, 3.0))
            return lambda image: cv2.bilateralFilter(image, 7, colour, space).astype(np.uint8)
        case "nlm":
            strength = float(rng.uniform(3.0, 10.0))
            return lambda image: cv2.fastNlMeansDenoising(image, np.empty_like(image), strength, 5, 11).astype(np.uint8)
        case "colour":
            return _jpeg(int(rng.choice([75, 85, 95])))
        case _:
            return _jpeg(int(processing.split()[1]))


def _jpeg(quality: int) -> Process:
    """OpenCV's encoder halves the resolution of chroma (4:2:0)."""

    def process(image: Pixels) -> Pixels:
        _, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(code, cv2.IMREAD_UNCHANGED), np.uint8)

    return process


HEIGHT, WIDTH = 150, 200
STEPS = 1 << 20  # Of the table of a curve
CYCLE_S = 0.02  # Least time from one shot to the next
LIMITS = ExposureLimits(1.0, 1e6, 0.0, 48.0)
STEP_STOPS = 0.5  # Between exposures of a sound sweep, as `plan_sweep` takes them
Kind = Literal["sound", "few", "clipped", "noisy", "offset", "proportion", "one wrong", "drift", "flicker"]
KINDS: tuple[Kind, ...] = (
    "sound", "sound", "sound", "sound", "few", "few", "clipped", "noisy",
    "offset", "offset", "proportion", "proportion", "one wrong", "drift", "flicker",
)  # fmt: skip
"""Every seed takes the next: four of 15 are sound."""

# What makes colours of three channels: each row one channel's part in all.
MIX = np.array([[1.6, -0.2, 0.0], [-0.5, 1.4, -0.4], [-0.1, -0.2, 1.4]])
Scene = Literal["textured", "uniform", "natural"]
Values = Floats


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSweep:
    """A sweep, what was done to it, and the truth."""

    kind: Kind  # how it was spoilt; "sound": not at all. "few", "clipped" and "noisy" are sound but poor.
    processing: Processing  # what the camera does to its images
    curve: str  # name of the camera's curve
    scene: Scene  # whether the scene had more than one brightness
    # Whether exposures were repeated: three frames each (one if processed), up and down again. Otherwise once each, as
    # files.
    repeated: bool
    sweep: Sweep  # the images
    # The same at a higher gain, if exposures were repeated and the scene is uniform: as the command takes it.
    brighter: tuple[Shot, ...]
    true: ResponseFunction  # the response of the camera

    @property
    def good(self) -> bool:
        """Whether a calibration may not refuse it."""
        return self.kind == "sound"


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """EMVA 1288's linear sensor, then a curve from 0 at 0 to 1 at 1, then quantisation."""

    curve: Values
    full_well_e: float
    read_noise_e: float
    black: float
    bit_depth: int

    def expose(self, electrons: Values, gain: float, rng: np.random.Generator) -> Pixels:
        """One channel, shape (height, width), or three that mix."""
        noise = rng.standard_normal(electrons.shape) * np.sqrt(electrons + self.read_noise_e**2)
        share = np.minimum(gain * (electrons + noise) / self.full_well_e, 1.0)
        share = (share if share.ndim == 2 else np.minimum(share @ MIX, 1.0)) + self.black
        table = np.rint(self.curve * (2**self.bit_depth - 1)).astype(np.uint8 if self.bit_depth == 8 else np.uint16)
        return np.asarray(table[np.clip(share * (STEPS - 1) + 0.5, 0, STEPS - 1).astype(np.intp)])

    def response(self) -> ResponseFunction:
        """As an error-free calibration would find it; black stands for half a grey level of light."""
        deep = self.bit_depth > 8
        greys = self.curve * (2**self.bit_depth - 1) / 2 ** (self.bit_depth - 8)
        # Of the codes that become one grey level, the middle one.
        own = np.arange(256) + ((0.5 - 0.5 / 2 ** (self.bit_depth - 8)) if deep else 0.0)
        share = np.linspace(0.0, 1.0, STEPS)
        black = float(np.interp(self.black, share, greys))
        light = np.interp(np.maximum(own, black + 0.5), greys, share) - self.black
        return ResponseFunction(np.log2(light / light[-1]), int(black) if deep else round(black), 255)


def simulated(
    seed: int, kind: Kind | None = None, processing: Processing = "raw", radiance: Values | None = None
) -> SimulatedSweep:
    """The sweep of a seed: of the kind that is its turn unless one is given, of a scene of its own likewise. A given
    radiance has the shape (HEIGHT, WIDTH), and is 1 at the brightest."""
    rng, of_processing = np.random.default_rng([seed, 19]), np.random.default_rng([seed, 46])
    kind = kind or KINDS[seed % len(KINDS)]
    curve = tuple(CURVES)[int(rng.integers(len(CURVES)))]
    camera = _Camera(
        curve=CURVES[curve](np.linspace(0.0, 1.0, STEPS), rng),
        full_well_e=float(rng.uniform(800.0, 3000.0) if kind == "noisy" else rng.uniform(8000.0, 25000.0)),
        read_noise_e=float(rng.uniform(2.0, 12.0)),
        black=float(rng.choice([0.0, rng.uniform(0.0, 0.03)])),
        bit_depth=12 if rng.random() < 0.3 and processing == "raw" else 8,
    )
    scene: Scene = "uniform" if rng.random() < 0.4 else "textured"
    if processing != "raw" and scene == "textured" and of_processing.random() < 0.5:
        scene = "natural"
    repeated = bool(rng.random() < 0.75)
    if radiance is None:
        radiance = _radiance(scene, rng)
    else:
        scene = "natural"
    full_us = float(rng.uniform(3e3, 3e4))
    times_us = np.round(full_us * np.exp2(_levels(kind, camera, radiance, rng)), 1)
    really_us = _REALLY.get(kind, _as_stated)(times_us, rng)
    once = np.arange(len(times_us))
    frames = 3 if processing == "raw" else 1
    order = np.repeat([*once, *reversed(once)], frames) if repeated else once
    gains_db = (0.0, _higher_gain_db(times_us)) if repeated and scene == "uniform" else (0.0,)
    starts_s = np.cumsum([0.0, *(max(CYCLE_S, times_us[i] * 1e-6 + 0.002) for i in np.tile(order, len(gains_db)))])
    light = _light(kind, float(starts_s[-1]), rng)
    process = process_of(processing, of_processing)
    channels = _channels(of_processing) if processing == "colour" else None
    shots = []
    for place, start_s in enumerate(map(float, starts_s[:-1])):
        index, gain_db = order[place % len(order)], gains_db[place // len(order)]
        factor = light.mean_lux(start_s, float(really_us[index]) * 1e-6)
        electrons = radiance * (camera.full_well_e * factor * really_us[index] / full_us)
        if channels is not None:
            electrons = electrons[..., None] * channels
        setting = ExposureSetting(float(times_us[index]), gain_db)
        image = process(camera.expose(electrons, linear_gain(gain_db), rng))
        image = image if image.ndim == 2 else image[..., GREEN]
        shots.append(Shot(image, camera.bit_depth, setting, start_s if repeated else None))
    sweep, brighter = Sweep(tuple(shots[: len(order)])), tuple(shots[len(order) :])
    return SimulatedSweep(kind, processing, curve, scene, repeated, sweep, brighter, camera.response())


def _higher_gain_db(times_us: Values) -> float:
    plan = SweepPlan(tuple(ExposureSetting(float(time_us), 0.0) for time_us in times_us))
    brighter = plan.brighter(LIMITS)
    assert brighter is not None
    return brighter.settings[0].gain_db


# Curves, from 0 at 0 to 1 at 1


def _srgb(light: Values, _: np.random.Generator) -> Values:
    return np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _s_shaped(light: Values, _: np.random.Generator) -> Values:
    root = np.sqrt(light)
    return 0.4 * root + 0.6 * root * root * (3.0 - 2.0 * root)


def _drawn(light: Values, rng: np.random.Generator) -> Values:
    """A mix of a power law, a knee and a toe."""
    power = light ** rng.uniform(0.4, 1.0)
    knee, toe = rng.uniform(0.2, 2.0), rng.uniform(0.0, 0.5)
    curve = power * (1.0 + knee) / (power + knee)
    return np.asarray((1.0 - toe) * curve + toe * curve * curve * (3.0 - 2.0 * curve))


CURVES: dict[str, Callable[[Values, np.random.Generator], Values]] = {
    "linear": lambda light, _: light,
    "gamma": lambda light, _: light ** (1 / 2.2),
    "srgb": _srgb,
    "s_shaped": _s_shaped,
    "drawn": _drawn,
}


def _radiance(scene: Scene, rng: np.random.Generator) -> Values:
    """1 at the brightest: a wall that the lens darkens towards the corners by a tenth, or texture over seven stops."""
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    if scene == "natural":
        return _natural(rng)
    if scene == "uniform":
        return np.asarray(1.0 - rng.uniform(0.02, 0.05) * (x**2 + y**2))
    texture = np.zeros((HEIGHT, WIDTH))
    for period in (3, 9, 30):
        coarse = rng.standard_normal((HEIGHT // period + 2, WIDTH // period + 2))
        texture += np.kron(coarse, np.ones((period, period)))[:HEIGHT, :WIDTH]
    stops = rng.uniform(1.0, 3.0) * y + 0.4 * texture
    return np.asarray(np.exp2(stops - np.percentile(stops, 99)))


def _natural(rng: np.random.Generator) -> Values:
    """Contrast at all scales, as photographs have it, over some seven stops: amplitudes fall with spatial frequency."""
    frequency = np.hypot(np.fft.fftfreq(HEIGHT)[:, None], np.fft.rfftfreq(WIDTH)) + 1.0 / WIDTH
    waves = np.fft.rfft2(rng.standard_normal((HEIGHT, WIDTH))) / frequency ** rng.uniform(1.0, 1.5)
    stops = np.fft.irfft2(waves, (HEIGHT, WIDTH))
    stops *= rng.uniform(1.0, 2.0) / stops.std()
    return np.asarray(np.exp2(stops - np.percentile(stops, 99)))


def _channels(rng: np.random.Generator) -> Values:
    """The light of each channel relative to green, shape (height, width, 3): patches of colour."""
    coarse = np.exp2(0.4 * rng.standard_normal((HEIGHT // 15, WIDTH // 20, 3)))
    coarse[..., GREEN] = 1.0
    return np.asarray(np.kron(coarse, np.ones((15, 20, 1))))


# Exposures as stated, and as they are


def _levels(kind: Kind, camera: _Camera, radiance: Values, rng: np.random.Generator) -> Values:
    """Stops from the exposure that fills the brightest pixel: nearly all black to nearly all white."""
    dark = max(float(np.interp(7.0 / 255.0, camera.curve, np.linspace(0.0, 1.0, STEPS))) - camera.black, 1e-4)
    low, high = np.log2([dark / np.percentile(radiance, 95), 1.0 / np.percentile(radiance, 5)]) + rng.uniform(
        -0.5, 0.5, 2
    )
    if kind == "few":
        return np.linspace(rng.uniform(0.3, 0.8) * low, high - rng.uniform(0.3, 1.5), int(rng.integers(3, 7)))
    if kind == "clipped":
        part = rng.uniform(0.25, 0.45) * (high - low)
        low, high = (low, high - part) if rng.random() < 0.5 else (low + part, high)
    return np.linspace(low, high, max(int(np.ceil((high - low) / STEP_STOPS)) + 1, 3))


def _as_stated(times_us: Values, rng: np.random.Generator) -> Values:
    return times_us


def _offset(times_us: Values, rng: np.random.Generator) -> Values:
    """Every exposure longer or shorter than stated by the same time."""
    offset_us = times_us[0] * np.exp2(rng.uniform(-2.0, 2.0))
    longer = rng.random() < 0.6
    return np.asarray(times_us + offset_us if longer else np.maximum(times_us - offset_us, 0.2 * times_us))


def _out_of_proportion(times_us: Values, rng: np.random.Generator) -> Values:
    """A power law, or a bend in the middle of the range."""
    octaves = np.log2(times_us / times_us.mean())
    sign = rng.choice([-1.0, 1.0])
    if rng.random() < 0.5:
        return np.asarray(times_us * np.exp2(sign * rng.uniform(0.05, 0.3) * octaves))
    return np.asarray(times_us * np.exp2(sign * rng.uniform(0.1, 0.8) * np.tanh(octaves)))


def _one_wrong(times_us: Values, rng: np.random.Generator) -> Values:
    wrong = times_us.copy()
    wrong[rng.integers(len(wrong))] *= np.exp2(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 1.0))
    return wrong


_REALLY: dict[Kind, Callable[[Values, np.random.Generator], Values]] = {
    "offset": _offset,
    "proportion": _out_of_proportion,
    "one wrong": _one_wrong,
}


def _light(kind: Kind, duration_s: float, rng: np.random.Generator) -> LightScript:
    """Light over time, as a factor."""
    if kind == "drift":
        last = float(np.exp2(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.5)))
        return LightScript((Change(0.0, 1.0), Change(1e-3, last, duration_s)))
    depth = float(rng.uniform(0.02, 0.6))
    return LightScript((Change(0.0, 1.0),), None, Flicker(100.0, depth) if kind == "flicker" else None)


@dataclass(frozen=True, slots=True)
class Stated:
    """One sweep: the verdict, and the error stated and true."""

    # seed, kind, processing, curve, scene, repeated, good: of the sweep, see `SimulatedSweep`.
    seed: int
    kind: str
    processing: str
    curve: str
    scene: str
    repeated: bool
    good: bool
    # verdict, reasons: of the calibration.
    verdict: Verdict
    reasons: tuple[str, ...]
    # stated_stops, true_stops: see `errors_stops`; None where the sweep was refused, which states nothing.
    stated_stops: float | None
    true_stops: float | None
    seconds: float  # processor time of the calibration

    @property
    def covered(self) -> bool:
        """Whether the stated error is at least the true one, or nothing is stated."""
        return self.stated_stops is None or self.true_stops is None or self.true_stops <= self.stated_stops


def scored(seed: int, case: SimulatedSweep) -> Stated:
    """Calibrate with a sweep and compare."""
    start_s = time.process_time()
    result = calibrate("simulated", Origin(), case.sweep, brighter=lambda: case.brighter)
    seconds = time.process_time() - start_s
    kept = None if result.file is None else result.solution
    stated, true = (None, None) if kept is None else errors_stops(kept, case.true)
    reasons = tuple(finding.reason for finding in result.findings)
    of_case = {name: getattr(case, name) for name in ("kind", "processing", "curve", "scene", "repeated", "good")}
    return Stated(
        seed, **of_case, verdict=result.verdict, reasons=reasons, stated_stops=stated, true_stops=true, seconds=seconds
    )


def errors_stops(solution: ResponseSolution, true: ResponseFunction) -> tuple[float, float]:
    """The error as the report states it, and the true one (stops), both the largest over the accurate grey levels."""
    assert solution.accurate is not None
    low, high = solution.accurate
    accurate = np.arange(low, high + 1)
    difference = solution.response.log2_exposure - true.log2_exposure
    true_stops = float(np.abs(difference[accurate] - difference[(low + high) // 2]).max())
    return SIGMAS * float(solution.uncertainty_stops[accurate].max()), true_stops
