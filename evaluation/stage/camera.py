"""The simulated camera, from radiance to the frames that control gets, and a control loop with a delay before it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from evaluation.arrays import Floats32, Greys
from fake_camera.imaging import ImageSettings
from fake_camera.world.response import CURVES
from fake_camera.world.sensor import DEFAULT_F_NUMBER, Sensor, SensorModel
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.python310 import exp2
from imaging.response import ResponseFunction

LIMITS = ExposureLimits(min_time_us=20.0, max_time_us=7500.0, min_gain_db=0.0, max_gain_db=30.0)
Image = Greys
Radiance = Floats32


class SimulatedCamera:
    """A camera whose noise in a frame is the same whatever the exposure. `seed`: of what is fixed in the sensor.
    `noise_seed`: of the noise in its frames. `response`, `gamma`: name of the sensor's response function, and the
    camera's Gamma node, a power law on top of it."""

    def __init__(
        self,
        seed: int,
        noise_seed: int,
        response: str = "linear",
        gamma: float = 1.0,
        lens_f_number: float = DEFAULT_F_NUMBER,
    ) -> None:
        self._sensor = Sensor(SensorModel(lens_f_number=lens_f_number), seed, response)
        self._noise_seed, self._gamma = noise_seed, gamma

    def expose(self, radiance: Radiance, setting: ExposureSetting, frame: int) -> Image:
        """The image of a radiance, uint8, (540, 720)."""
        model = self._sensor.model
        settings = ImageSettings(
            setting.exposure_time_us, setting.gain_db, 0.0, self._gamma, "Mono8", 0, 0, model.width, model.height, 1, 1
        )
        return self._sensor.expose(radiance, settings, self._noise_seed * 100_000 + frame).astype(np.uint8, copy=False)


def pair_of(images: Mapping[CameraName, Image], setting: ExposureSetting, number: int, time_s: float) -> FrameSet:
    """Images as control gets them: the frames of trigger `number`, taken at a time on which all clocks agree."""
    time_ns = round(time_s * 1e9)
    frames = {camera: Frame(image, 8, number, time_ns, time_ns, time_ns, setting) for camera, image in images.items()}
    return FrameSet(number, frames)


def time_first(level: float) -> ExposureSetting:
    """The setting of an exposure level (stops) that takes time before gain."""
    return LIMITS.realise(level, exp2(level))


@dataclass(frozen=True, slots=True)
class CameraResponse:
    """A sensor's response function and the camera's Gamma node on top of it, a power law."""

    curve: str = "linear"  # name of the sensor's response (`fake_camera.world.response.CURVES`)
    gamma: float = 1.0  # the Gamma node; below 1 it brightens

    @property
    def function(self) -> ResponseFunction:
        """What an error-free calibration would find."""
        return _function(self.curve, self.gamma)

    def __str__(self) -> str:
        return self.curve.replace("_", "-") + (f"^{self.gamma:g}" if self.gamma != 1.0 else "")


FAKE_CAMERAS = tuple(CameraResponse(curve) for curve in CURVES)  # Those available to fake cameras


@cache
def _function(curve: str, gamma: float) -> ResponseFunction:
    light = np.concatenate([[0.0], np.logspace(-14, 0, 500_001)])
    greys = 255.0 * CURVES[curve](light) ** gamma
    # As in `ResponseFunction.linear`, black stands for half a grey level of light.
    inverse = np.interp(np.maximum(np.arange(256.0), 0.5), greys, light)
    return ResponseFunction(np.log2(inverse / inverse[-1]), 0, 255)


class DelayedLoop:
    """Takes each frame with the setting decided `delay_frames` earlier, and decides on it. The first `delay_frames`
    frames are taken with its start. `delay_frames`: a decision on frame k applies from frame k + delay_frames, which is
    at least 1. `decisions`: one for each frame so far, with M_g."""

    def __init__(self, loop: ControlLoop, delay_frames: int) -> None:
        self.loop = loop
        self.loop.metric_asked = True
        self.decisions: list[Decision] = []
        self._settings = [loop.setup.start] * delay_frames

    @property
    def metrics(self) -> list[float]:
        """M_g of each frame so far."""
        return [decision.metric for decision in self.decisions if decision.metric is not None]

    @property
    def settings(self) -> list[ExposureSetting]:
        """The setting of each frame so far."""
        return self._settings[: len(self.decisions)]

    def step(self, take: Callable[[ExposureSetting], FrameSet]) -> FrameSet:
        """Take the next frame with `take`, decide on it, and return it."""
        pair = take(self._settings[len(self.decisions)])
        self.decisions.append(self.loop.step(pair))
        self._settings.append(self.decisions[-1].setting)
        return pair


MakeLoop = Callable[[ResponseFunction, ExposureLimits, ExposureSetting], ControlLoop]


@dataclass(frozen=True, slots=True)
class Entrant:
    """A participant: its name, its delay (see `DelayedLoop`), and how its control loop is made."""

    name: str
    delay_frames: int
    make_loop: MakeLoop

    @classmethod
    def of(cls, policy_id: str, delay_frames: int = 2) -> Entrant:
        """A policy by its id."""
        return cls(policy_id, delay_frames, partial(ControlLoop, policy_id))

    def enter(self, start: ExposureSetting) -> DelayedLoop:
        """A fresh loop for linear cameras that starts from a setting."""
        return DelayedLoop(self.make_loop(ResponseFunction.linear(), LIMITS, start), self.delay_frames)
