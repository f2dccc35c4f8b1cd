"""A tiny world for closed loops in virtual time: a picture of light, a camera with a delay, a simulated clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.table import build_policy
from autoexpose_daemon.control.policy import ExposurePolicy
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.step import StepInputs
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.geometry import SIDES
from imaging.response import ResponseFunction

LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
FRAME_NS = 16_666_667

NOTHING_GIVEN = StepInputs(FrameSet(0, {}))
"""For observations that are made without a loop."""


def policy_of(policy_id: str) -> ExposurePolicy:
    """With exposure priority, for linear cameras."""
    tuning = ControlParameters(balance="exposure_priority")
    return build_policy(
        ControlSetup(policy_id, dict.fromkeys(SIDES, LINEAR), LIMITS, ExposureSetting(1000.0, 6.0), tuning)
    )


def radiance(seed: int = 0, spread_stops: float = 1.0, shape: tuple[int, int] = (136, 180)) -> NDArray[np.float64]:
    """Patches of log-normal brightness with median 1, shape (height, width)."""
    rng = np.random.default_rng(seed)
    height, width = shape
    patches = rng.normal(0, spread_stops, (height // 8 + 1, width // 8 + 1))
    light = np.exp2(np.kron(patches, np.ones((8, 8)))[:height, :width])
    return np.asarray(light / np.median(light))


def expose(light: NDArray[np.float64], setting: ExposureSetting, half_scale_level: float, bits: int = 8) -> Frame:
    """A noiseless linear frame: light 1 gives half of full scale at `half_scale_level`."""
    full = 2**bits - 1
    grey = np.rint(np.minimum(light * (0.5 * 2 ** (setting.level - half_scale_level)), 1) * full)
    return Frame(grey.astype(np.uint8 if bits == 8 else np.uint16), bits, 0, 0, 0, 0, setting)


def at_time(frame: Frame, index: int) -> Frame:
    return Frame(frame.pixels, frame.bit_depth, index, index * FRAME_NS, 0, 0, frame.setting)


def drive(
    loop: ControlLoop,
    frames: int,
    take: Callable[[int, ExposureSetting], StepInputs | FrameSet],
    delay: int = 2,
    *,
    start: ExposureSetting = START,
    watch: Callable[[Decision], None] = lambda _: None,
) -> list[Decision]:
    """Decisions on what is taken, by index and setting; each shows `delay` frames later."""
    settings, decisions = [start] * delay, []
    for index in range(frames):
        decisions.append(loop.step(take(index, settings[index])))
        settings.append(decisions[-1].setting)
        watch(decisions[-1])
    return decisions


def alike(frame: Frame, index: int) -> FrameSet:
    """The same frame of both cameras."""
    return FrameSet(index, dict.fromkeys(SIDES, at_time(frame, index)))


def run(
    loop: ControlLoop,
    lights: Sequence[float],
    start: ExposureSetting,
    *,
    delay: int = 2,
    scene: NDArray[np.float64] | None = None,
    watch: Callable[[Decision], None] = lambda _: None,
) -> list[float]:
    """Levels of the frames taken while half scale lies at `lights`; a decision shows `delay` frames later."""
    picture, levels = radiance() if scene is None else scene, []

    def take(index: int, setting: ExposureSetting) -> FrameSet:
        levels.append(setting.level)
        return alike(expose(picture, setting, lights[index]), index)

    drive(loop, len(lights), take, delay, start=start, watch=watch)
    return levels
