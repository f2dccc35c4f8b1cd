"""A still scene, and what is measured on it: gain, changes of exposure and of light, and where laws come to rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import ArrayLike

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import CONTROL_SIZE, ImagePreparation
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.policies.published.gamma import gamma_table
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from evaluation.arrays import Floats, Greys
from evaluation.jobs.job import Plain
from evaluation.scenes.scenarios import RATE_HZ, Course, no_turn, steady
from evaluation.scenes.views import build_views
from evaluation.stage.camera import LIMITS, CameraResponse, DelayedLoop, Image, pair_of, time_first
from evaluation.stage.oracle import Oracle
from evaluation.stage.rendering import Stage
from fake_camera.world.lighting import Change, LightScript
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.response import GREY_LEVELS, ResponseFunction, prediction_table


class StillLife:
    """What the left camera sees of a scene. `scene`, `seed`: as for `evaluation.scenes.views.build_views`."""

    def __init__(self, scene: str, seed: int, lux: float, camera: CameraResponse) -> None:
        self._stage = still_stage(scene, seed, steady(lux), camera)

    def take(self, setting: ExposureSetting, shot: int = 0) -> Greys:
        """An image, uint8, (540, 720); each shot has its own noise."""
        if shot != self._stage.frame:
            self._stage.go_to(shot)
        return self._stage.expose("left", setting)


def camera_of(arguments: Mapping[str, Any]) -> CameraResponse:
    """The camera that a job names."""
    return CameraResponse(*arguments["camera"])


def still_stage(scene: str, seed: int, light: LightScript, camera: CameraResponse) -> Stage:
    """A scene that does not move, seen by a camera with a response."""
    views = build_views(scene, seed, no_turn, at_window=False)
    return Stage(views, Course(light, no_turn, 0), seed, response=camera.curve, gamma=camera.gamma)


def plateau_centre(levels: Floats, metrics: Floats, share: float = 0.99) -> float:
    """The best level: the middle of those around the maximum that reach `share` of it, because maxima are flat."""
    top = int(np.argmax(metrics))
    good = metrics >= share * metrics[top]
    low = top - int(np.argmin(good[top::-1])) + 1 if not good[: top + 1].all() else 0
    high = top + int(np.argmin(good[top:])) - 1 if not good[top:].all() else len(good) - 1
    return float((levels[low] + levels[high]) / 2)


# The gamma that predicts a change best is sought among these: 1/16 to 16.
GAMMAS: Floats = np.exp2(np.arange(-4.0, 4.001, 0.02))
# Greys nearer than this to black or white may be clipped in some shots, and say nothing about light.
_CLIPPED_MARGIN = 3


def gamma_curve(gamma: float) -> Floats:
    """Eq. (15) for every grey level, not rounded, shape (256,)."""
    return np.asarray(255.0 * (np.arange(GREY_LEVELS) / 255.0) ** gamma)


def measure_changes(
    *, scene: str, seed: int, lux: float, camera: list[Any], level: float, changes: list[float], shots: int
) -> Plain:
    """Photograph a still scene at a level and after changes of it (stops), and compare with what curves predict. Noise
    is averaged out over shots. Errors are over the pixels that are neither black nor white at `level`. Returns for each
    change {"change", "seen": for each grey level at `level` the mean one after the change or None, "response_rms",
    "gamma_rms", "gamma"}: errors in grey levels of the prediction by the camera's response, and of the gamma curve with
    the smallest error, chosen with knowledge of the outcome."""
    response = CameraResponse(*camera)
    life = StillLife(scene, seed, lux, response)
    before = _mean_of(life, level, shots)
    usable = (before > _CLIPPED_MARGIN) & (before < 255 - _CLIPPED_MARGIN)
    greys = np.rint(before[usable]).astype(np.intp)
    counts = np.bincount(greys, minlength=GREY_LEVELS)
    found: list[Plain] = []
    for change in changes:
        after = _mean_of(life, level + change, shots)[usable]
        seen = np.bincount(greys, after, GREY_LEVELS) / np.maximum(counts, 1)
        curves = np.stack([gamma_curve(gamma) for gamma in GAMMAS])
        errors = np.sqrt(np.sum(counts * (curves - seen) ** 2, axis=1) / counts.sum())
        table = prediction_table(response.function, change)
        found.append(
            {
                "change": change,
                "seen": [float(s) if n >= 10 else None for s, n in zip(seen, counts, strict=True)],
                "response_rms": float(np.sqrt(np.sum(counts * (table - seen) ** 2) / counts.sum())),
                "gamma_rms": float(errors.min()),
                "gamma": float(GAMMAS[np.argmin(errors)]),
            }
        )
    return found


def _mean_of(life: StillLife, level: float, shots: int) -> Floats:
    setting = time_first(level)
    total = np.zeros(life.take(setting).shape)
    for shot in range(shots):
        total += life.take(setting, shot)
    return total / shots


DELTAS = (0.06, 0.30)  # Activation thresholds: Shim's, and Begin & Hunter's
GAINS_DB = tuple(range(0, 49, 6))  # Up to the most that the paper's camera can give; the arena's limit is 30
Rows: TypeAlias = "Sequence[Mapping[str, Any]]"  # What `measure` returns
_PREPARATION = ImagePreparation()
_LIFTED = gamma_table(0.3)

# What is done to an image before it is measured. `control` shrinks it and takes a median, as the paper says and the
# daemon does. `lifted` first applies the paper's gamma of 0.3, which brightens dark parts. `shrunk` leaves out the
# median, as the paper's code in effect does. `raw` does nothing.
VIEWS: Mapping[str, Callable[[Image], Image]] = {
    "control": _PREPARATION.prepare,
    "lifted": lambda image: _PREPARATION.prepare(np.asarray(cv2.LUT(image, _LIFTED), np.uint8)),
    "shrunk": lambda image: np.asarray(cv2.resize(image, CONTROL_SIZE, interpolation=cv2.INTER_AREA), np.uint8),
    "raw": lambda image: image,
}


def pairs_of(level: float) -> list[ExposureSetting]:
    """All settings of a level (stops) with a gain of `GAINS_DB` and a time that the camera supports."""
    settings = [ExposureSetting(2.0 ** (level - gain / DB_PER_STOP), float(gain)) for gain in GAINS_DB]
    return [s for s in settings if LIMITS.min_time_us <= s.exposure_time_us <= LIMITS.max_time_us]


def measure_coupling(scene: str, seed: int, lux: float, levels: list[float], shots: int) -> Plain:
    """The metric of a still scene for each level, gain, view and delta, averaged over shots. Returns a list of
    {"level", "gain_db", view: [M_g of each of `DELTAS`]}."""
    life = StillLife(scene, seed, lux, CameraResponse())
    metrics = [GradientMetric(delta) for delta in DELTAS]
    rows: list[Plain] = []
    for level in levels:
        for setting in pairs_of(level):
            sums = {name: np.zeros(len(DELTAS)) for name in VIEWS}
            for shot in range(shots):
                image = life.take(setting, shot)
                for name, view in VIEWS.items():
                    seen = view(image)
                    sums[name] += [metric.measure(seen) for metric in metrics]
            rows.append(
                {"level": level, "gain_db": setting.gain_db} | {name: (s / shots).tolist() for name, s in sums.items()}
            )
    return rows


def curve_of_least_gain(rows: Rows, view: str, delta: float) -> tuple[Floats, Floats]:
    """Levels, and the metric (view, delta) of the pair with the lowest gain at each."""
    by_level: dict[float, float] = {}
    for row in sorted(rows, key=lambda row: (row["level"], row["gain_db"])):
        by_level.setdefault(row["level"], row[view][DELTAS.index(delta)])
    return np.array(list(by_level)), np.array(list(by_level.values()))


def coupling(rows: Rows, view: str, delta: float, max_gain_db: float) -> dict[float, float]:
    """For each level with several gains: largest minus least metric over gains, as a share of the curve's peak."""
    _, curve = curve_of_least_gain(rows, view, delta)
    by_level: dict[float, list[float]] = {}
    for row in rows:
        if row["gain_db"] <= max_gain_db:
            by_level.setdefault(row["level"], []).append(row[view][DELTAS.index(delta)])
    return {level: float(np.ptp(values) / curve.max()) for level, values in by_level.items() if len(values) > 1}


LAWS = ("begin2022", "shim2018", "mehta2020")  # One predicts through the response function, two by gamma curves
_UNBOUNDED = ExposureLimits(1e-6, 1e15, 0.0, 0.0)  # So that a step is what the law wants, not what a camera could do


def measure_rest(scene: str, seed: int, lux: float, camera: list[Any], levels: list[float]) -> Plain:
    """The metric of a still scene at each level, and the step (stops) that each law wants to take from there. `camera`:
    curve and gamma of its response. `levels`: exposure levels (stops), ascending. Returns {"levels", "metrics", law:
    steps}, lists of equal length."""
    response = CameraResponse(*camera)
    life = StillLife(scene, seed, lux, response)
    metric, preparation = GradientMetric(), ImagePreparation()
    metrics: list[float] = []
    steps: dict[str, list[float]] = {law: [] for law in LAWS}
    for level in levels:
        setting = time_first(level)
        image = life.take(setting)
        metrics.append(metric.measure(preparation.prepare(image)))
        for law in LAWS:
            steps[law].append(step_of(law, response.function, image, setting))
    return {"levels": levels, "metrics": metrics} | steps


def step_of(law: str, response: ResponseFunction, image: Greys, setting: ExposureSetting) -> float:
    """The change of level (stops) that a law wants after one image, knowing no other."""
    loop = ControlLoop(law, response, _UNBOUNDED, setting)
    return loop.step(pair_of({"left": image}, setting, 0, 0.0)).level - setting.level


def rest_level(levels: Floats, steps: Floats, near: float) -> float:
    """The level where a law comes to rest: it wants to go up below it and down above it. Of several such levels, the
    one nearest to `near`; NaN for none."""
    turns = np.flatnonzero((steps[:-1] > 0) & (steps[1:] <= 0))
    if not turns.size:
        return float("nan")
    rests = levels[turns] + (levels[turns + 1] - levels[turns]) * steps[turns] / (steps[turns] - steps[turns + 1])
    return float(rests[np.argmin(np.abs(rests - near))])


def summary(measured: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """For each law in a result of `measure`: where it rests, its bias (stops), and the share of the best metric there.
    Under "true" is the best level, from which biases count."""
    levels, metrics = np.array(measured["levels"]), np.array(measured["metrics"])
    best = plateau_centre(levels, metrics)
    found = {"true": {"level": best}}
    for law in LAWS:
        rest = rest_level(levels, np.array(measured[law]), best)
        share = float(np.interp(rest, levels, metrics) / metrics.max())
        found[law] = {"level": rest, "bias": rest - best, "share": share}
    return found


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


def measure_step(scene: str, seed: int, camera: list[Any], before_lux: float, rise_stops: float) -> Plain:
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
        run.step(partial(stage.take, cameras=("left",)))
    return [setting.level for setting in run.settings], run.metrics


def frames_to_converge(levels: ArrayLike, share: float) -> int | None:
    """Frames from the first after the step to the first that stays near where the law ends; None for never. `levels`:
    of all frames of a run (stops). `share`: of the best metric, reached at the end."""
    after = np.asarray(levels, np.float64)[WARM_UP_FRAMES:]
    away = np.flatnonzero(np.abs(after - np.median(after[-END_FRAMES:])) > BAND_STOPS)
    frames = int(away[-1]) + 1 if away.size else 0
    return frames if share >= USEFUL_SHARE and frames <= len(after) - END_FRAMES else None
