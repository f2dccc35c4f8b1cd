"""How exposure laws respond to a light that is switched on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from evaluation.experiments.experiment import Plain
from evaluation.experiments.prediction.still_life import still_stage
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import LIMITS, CameraResponse, DelayedLoop
from evaluation.stage.oracle import Oracle
from evaluation.stage.rendering import Stage
from fake_camera.world.lighting import Change, LightScript
from imaging.exposure import ExposureSetting

WARM_UP_FRAMES = 30  # Time to go from the best exposure to the one that a law prefers, before the light is switched on
FRAMES = 150  # Observed after the step: half again as many as the paper's slowest response takes
END_FRAMES = 20  # The level where a law ends is the median over this many last frames
BAND_STOPS = 0.25  # Converged: permanently within this distance of the level where the law ends
USEFUL_SHARE = 0.5  # A law that ends with a smaller share of the best metric is stuck, not converged


class WithoutFeedback(ExposurePolicy):
    """A law that never learns which decision a frame realises: for `begin2022`, only the first case of eq. (22)."""

    def __init__(self, law: ExposurePolicy) -> None:
        self.law, self.balance = law, law.balance

    def decide(self, observation: Observation) -> Target:
        """What the law would decide."""
        return self.law.decide(replace(observation, past=()))


class LeavesWhiteAndBlack(ExposurePolicy):
    """A law with the rule that is in the paper's published code but not in its text. After an image whose mean grey is
    above 245 or below 10, exposure goes 2 stops down or up, whatever the prediction."""

    def __init__(self, law: ExposurePolicy) -> None:
        self.law, self.balance = law, law.balance

    def decide(self, observation: Observation) -> Target:
        """What the rule decides where it applies, otherwise what the law decides."""
        mean = float(observation.image.mean())
        if 10 <= mean <= 245:
            return self.law.decide(observation)
        return Target(observation.setting.level + (2.0 if mean < 10 else -2.0), "black" if mean < 10 else "white")


class _ChangedLoop(ControlLoop):
    """The daemon's loop around a wrapped law."""

    def wrap(self, wrappers: Sequence[Callable[[ExposurePolicy], ExposurePolicy]]) -> ControlLoop:
        for wrapper in wrappers:
            self._policy = wrapper(self._policy)
        return self


@dataclass(frozen=True, slots=True)
class Contestant:
    """A policy, what is changed in it, and the delay (a decision on frame k shows in frame k + delay_frames)."""

    policy_id: str
    changes: tuple[Callable[[ExposurePolicy], ExposurePolicy], ...] = ()
    delay_frames: int = 2

    def loop(self, camera: CameraResponse, start: ExposureSetting) -> ControlLoop:
        """A fresh loop with the camera's response."""
        return _ChangedLoop(self.policy_id, camera.function, LIMITS, start).wrap(self.changes)


CONTESTANTS = {
    "feedback": Contestant("begin2022"),
    "no feedback": Contestant("begin2022", (WithoutFeedback,)),
    "feedback, rule": Contestant("begin2022", (LeavesWhiteAndBlack,)),
    "no feedback, rule": Contestant("begin2022", (WithoutFeedback, LeavesWhiteAndBlack)),
    "feedback, delay 1": Contestant("begin2022", delay_frames=1),
    "no feedback, delay 1": Contestant("begin2022", (WithoutFeedback,), delay_frames=1),
    "gamma": Contestant("mehta2020"),
    "gamma, shim2018": Contestant("shim2018"),
    DEFAULT_POLICY: Contestant(DEFAULT_POLICY),
}
"""By their names in results. Gamma prediction is Mehta's code, which is what the paper ran."""


def measure(scene: str, seed: int, camera: list[Any], before_lux: float, rise_stops: float) -> Plain:
    """Run every contestant through the same step of light on a still scene. Returns {"best_level": after the step,
    "start_level": of the first frame, name: {"levels": of all frames, "share": of the best metric at the end}}."""
    response = CameraResponse(*camera)
    step_s = (WARM_UP_FRAMES - 0.5) / RATE_HZ
    light = LightScript((Change(0.0, before_lux), Change(step_s, before_lux * 2.0**rise_stops)))
    stage = still_stage(scene, seed, light, response)
    oracle = Oracle(stage)
    first = oracle.best(ExposurePriority(), 0.0)
    start = LIMITS.brightest if first is None else LIMITS.realise(first.level, LIMITS.max_time_us)
    runs = {name: _run(stage, contestant, response, start) for name, contestant in CONTESTANTS.items()}
    best = oracle.best(ExposurePriority(), 0.0)  # the stage has stayed at the last frame
    assert best is not None
    ends = {name: float(np.median(metrics[-END_FRAMES:])) / best.metrics[0] for name, (_, metrics) in runs.items()}
    return {"best_level": best.level, "start_level": start.level} | {
        name: {"levels": levels, "share": ends[name]} for name, (levels, _) in runs.items()
    }


def _run(
    stage: Stage, contestant: Contestant, camera: CameraResponse, start: ExposureSetting
) -> tuple[list[float], list[float]]:
    """Level and metric of each frame."""
    run = DelayedLoop(contestant.loop(camera, start), contestant.delay_frames)
    for number in range(WARM_UP_FRAMES + FRAMES):
        stage.go_to(number)
        run.step(partial(stage.take, sides=("left",)))
    return [setting.level for setting in run.settings], run.metrics


def frames_to_converge(levels: ArrayLike, share: float) -> int | None:
    """Frames from the first after the step to the first that stays near where the law ends; None for never. `levels`:
    of all frames of a run (stops). `share`: of the best metric, reached at the end."""
    after = np.asarray(levels, np.float64)[WARM_UP_FRAMES:]
    away = np.flatnonzero(np.abs(after - np.median(after[-END_FRAMES:])) > BAND_STOPS)
    frames = int(away[-1]) + 1 if away.size else 0
    return frames if share >= USEFUL_SHARE and frames <= len(after) - END_FRAMES else None
