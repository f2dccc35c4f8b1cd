"""Policies in closed loop and virtual time, side by side through one course, against the best exposure; their scores.

Several variants through the same course share rendering and oracles: far cheaper than one by one.

    mine = Entrant("variant-a", 2, lambda response, limits, start: make_my_control_loop(response, limits, start))
    for series in run_course("tunnel", "leaves", 3, [Entrant.of("begin2022"), mine]):
        series.levels, series.metrics, series.ratios        # one value per frame
        series.score()                                      # settle_frames, metric_ratio_mean, ...

Scenarios: `scenarios.SCENARIOS`; scenes and seeds for tuning: `runs.TUNE_SCENES`, 0 to 99. Not for two threads at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from evaluation.arrays import Floats
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.scenes.views import build_views
from evaluation.stage.camera import LIMITS, DelayedLoop, Entrant, Radiance
from evaluation.stage.oracle import LEVELS, LONGEST_TIMES_US, Best, Oracle, best_start
from evaluation.stage.rendering import Stage
from fake_camera.world.sensor import SensorModel
from imaging.exposure import ExposureSetting, linear_gain
from imaging.frames import CameraName
from imaging.python310 import exp2

CELLS = 8
LOG2_RADIANCES = np.arange(-14.0, 18.0, 0.25)  # Bins of radiance, lux times reflectance in stops
# Grey levels that detectors need, whatever the noise, as in the objective of our policies; 8 serves as well.
FRONT_END = 6.0
BLUR_PX = 5.0  # In the shrunk image, a blur of this length halves the energy of gradients
GLIMPSE_S = 20e-6  # The shortest exposure: its radiance is the sharpest
LOST = 0.1  # A pair with a smaller share of the most that it could show is lost: as 20 of some 250 matches
_SENSOR = SensorModel()
# Half a stop apart, each split in several ways.
_TRIED = tuple(
    dict.fromkeys(
        LIMITS.realise(level, min(exp2(level), longest_us))
        for level in LEVELS[::4].tolist()
        for longest_us in LONGEST_TIMES_US.tolist()
    )
)

Variances = Floats  # By setting and radiance, (settings, bins); infinite where nothing shows


class SuccessiveFrames:
    """Judges pairs of successive frames of a stage, as far as the left camera is concerned. `stage`: at the second
    frame of each pair; a light that changes between the two is taken to fall on everything."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._frame = -1
        self._energy = np.empty(0)
        self._most = 0.0

    def share(self, first: ExposureSetting, second: ExposureSetting) -> float:
        """Information of the pair that ends here, as a share of the most that one setting for both gives; NaN: none."""
        if self._frame != self._stage.frame:
            self._frame = self._stage.frame
            self._energy = energy_by_radiance(self._stage.radiance("left", GLIMPSE_S))
            before, after = self._variances(self._frame - 1, _TRIED), self._variances(self._frame, _TRIED)
            self._most = float(information(self._energy, before, after).max())
        before, after = self._variances(self._frame - 1, (first,)), self._variances(self._frame, (second,))
        return float(information(self._energy, before, after)[0]) / self._most if self._most > 0 else np.nan

    def _variances(self, frame: int, settings: tuple[ExposureSetting, ...]) -> Variances:
        """Of a frame, by the radiance in the light of the present one."""
        start_s, light = self._stage.start_s(frame), self._stage.light
        now = light.mean_lux(self._stage.start_s(self._frame), GLIMPSE_S)
        times_s = np.array([setting.exposure_time_us * 1e-6 for setting in settings])
        lit = np.array([light.mean_lux(start_s, float(time_s)) / now for time_s in times_s])
        view = self._stage.views["left"]
        blur_px = np.array([view.image_shift_px(start_s, start_s + float(time_s)) / 2 for time_s in times_s])
        gains = np.array([linear_gain(setting.gain_db) for setting in settings])
        return variances(times_s * lit, gains) * (1.0 + (blur_px[:, None] / BLUR_PX) ** 2)


def variances(lit_s: Floats, gains: Floats) -> Variances:
    """Of log2 radiance as seen by settings; `lit_s` is their exposure times the light, in its present unit."""
    electrons = _SENSOR.sensitivity_e_per_lux_s * lit_s[:, None] * np.exp2(LOG2_RADIANCES)
    scale = 255.0 / _SENSOR.full_well_e * gains[:, None]
    grey = scale * electrons
    pixels = 4.0  # of the sensor, in one of the shrunk image
    noise = (scale**2 * (electrons + _SENSOR.read_noise_e**2) + 1 / 12) / pixels + 1 / 12
    return np.where(grey < 255.0, (noise + FRONT_END**2) / (grey * np.log(2)) ** 2, np.inf)


def information(energy: Floats, first: Variances, second: Variances) -> Floats:
    """Of pairs, (settings,), given the energy of gradients by cell and radiance."""
    return np.asarray(np.sqrt(energy @ (1.0 / (first + second)).T).mean(axis=0))


def energy_by_radiance(radiance: Radiance) -> Floats:
    """Mean over each cell's pixels of the energy of gradients in log2 radiance, (cells, bins). It is listed under the
    brightest of the five pixels that a gradient is from: if that is white, it is lost."""
    rows, columns = radiance.shape[0] // 2, radiance.shape[1] // 2
    small = radiance[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).mean(axis=(1, 3))
    logs = np.log2(np.maximum(small, 2.0 ** LOG2_RADIANCES[0]))
    middle = logs[1:-1, 1:-1]
    up, down, left, right = logs[:-2, 1:-1], logs[2:, 1:-1], logs[1:-1, :-2], logs[1:-1, 2:]
    energy = ((down - up) ** 2 + (right - left) ** 2) / 4
    brightest = np.maximum.reduce([middle, up, down, left, right])
    step = LOG2_RADIANCES[1] - LOG2_RADIANCES[0]
    bins = len(LOG2_RADIANCES)
    by_radiance = np.clip(np.rint((brightest - LOG2_RADIANCES[0]) / step), 0, bins - 1).astype(np.int64)
    y, x = (np.arange(size) * CELLS // size for size in energy.shape)
    cell = y[:, None] * CELLS + x[None]
    sums = np.bincount((cell * bins + by_radiance).ravel(), energy.ravel(), CELLS**2 * bins)
    pixels = np.bincount(cell.ravel(), minlength=CELLS**2)
    return np.asarray(sums.reshape(CELLS**2, bins) / pixels[:, None])


SETTLED_RATIO = 0.9
SETTLED_FRAMES = 10  # Settled: at least this share of the oracle's objective for this many frames in a row
STEADY_FRAMES = 30  # The steady state is the last half second
BAD_SHARE = 0.5  # A frame with a larger share of black and saturated pixels is bad


@dataclass(frozen=True, slots=True)
class CourseScore:
    """The scores of one run, over its scored frames."""

    # Frames from the first scored one (after a step: the first exposed entirely after it) to the first of ten in a row
    # that are settled; 0 when the first one is settled, None when the run never settles: it is stuck.
    settle_frames: int | None
    # How far the exposure level went past the oracle's, in the direction from the level of the first scored frame to
    # the oracle's there; 0 when it stayed on its side. Only frames before settling count, and the oracle's level is the
    # middle of its plateau.
    overshoot_stops: float
    steady_std_stops: float  # standard deviation of the exposure level over the last 30 frames
    # metric_ratio_mean, metric_ratio_p05: mean and fifth percentile of M_g as a share of the oracle's.
    metric_ratio_mean: float
    metric_ratio_p05: float
    bad_frame_share: float  # share of frames whose left image is more than half black or saturated
    gain_db_mean: float  # mean gain
    # objective_ratio_mean, objective_ratio_p05: mean and fifth percentile of what the policy maximises, information or
    # M_g, as a share of the oracle's.
    objective_ratio_mean: float
    objective_ratio_p05: float
    # Mean of M_g as a share of the best of all exposure times and gains, however the policy splits.
    any_split_ratio_mean: float
    # Mean information of two successive frames, as a share of the most that one setting for both gives.
    pair_ratio_mean: float
    lost_pair_share: float  # share of pairs with less than a tenth of it


def score(
    *,
    levels: Floats,
    oracle_levels: Floats,
    ratios: Floats,
    metric_ratios: Floats,
    any_split_ratios: Floats,
    pair_ratios: Floats,
    clipped_shares: Floats,
    gains_db: Floats,
    first_scored: int,
) -> CourseScore:
    """The scores of a run; all arrays have shape (frames,), and frames before `first_scored` do not count. `ratios` and
    `oracle_levels` are by what the policy maximises, `metric_ratios` and `any_split_ratios` by M_g, `pair_ratios` by
    the information of pairs. Frames whose ratio is NaN (no exposure shows anything) neither count as settled nor enter
    the ratios."""
    scored = slice(first_scored, None)
    settle = frames_to_settle(ratios[scored])
    by_objective, by_metric, by_any_split, pairs = (
        each[scored][~np.isnan(each[scored])] for each in (ratios, metric_ratios, any_split_ratios, pair_ratios)
    )
    return CourseScore(
        settle_frames=settle, overshoot_stops=overshoot(levels[scored], oracle_levels[scored], settle),
        steady_std_stops=float(levels[-STEADY_FRAMES:].std()), metric_ratio_mean=_mean(by_metric),
        metric_ratio_p05=_worst(by_metric), bad_frame_share=float(np.mean(clipped_shares[scored] > BAD_SHARE)),
        gain_db_mean=float(gains_db[scored].mean()), objective_ratio_mean=_mean(by_objective),
        objective_ratio_p05=_worst(by_objective), any_split_ratio_mean=_mean(by_any_split),
        pair_ratio_mean=_mean(pairs), lost_pair_share=float(np.mean(pairs < LOST)) if pairs.size else 1.0,
    )  # fmt: skip


def _mean(ratios: Floats) -> float:
    return float(ratios.mean()) if ratios.size else 0.0


def _worst(ratios: Floats) -> float:
    return float(np.percentile(ratios, 5)) if ratios.size else 0.0


def frames_to_settle(ratios: Floats) -> int | None:
    """Index of the first of ten ratios in a row of at least 0.9; None when there is no such row."""
    good = np.convolve(ratios >= SETTLED_RATIO, np.ones(SETTLED_FRAMES), "valid") if ratios.size else np.empty(0)
    settled = np.flatnonzero(np.rint(good) == SETTLED_FRAMES)
    return int(settled[0]) if settled.size else None


def overshoot(levels: Floats, oracle_levels: Floats, settle: int | None) -> float:
    """How far (stops) the levels went past the oracle's before settling; see `CourseScore`."""
    end = len(levels) if settle is None else settle + 1
    direction = np.sign(oracle_levels[0] - levels[0])
    beyond = direction * (levels[:end] - oracle_levels[:end])
    return float(max(beyond.max(initial=0.0), 0.0)) if np.isfinite(direction) else 0.0


LIGHT_JUMP_STOPS = 0.2  # Where the light or the lamp changes by more between two frames, the oracle is asked about both
SPLITS_EVERY = 4  # The best of all times and gains takes six searches: it is asked for so many times less often


@dataclass(slots=True, eq=False)
class Judgement:
    """The frames of one entrant by one objective, beside the oracle's: float64 arrays. The oracle is interpolated
    between the frames that it was asked about."""

    judged: list[tuple[float, ...]] = field(default_factory=list)
    best: dict[int, Best | None] = field(default_factory=dict)

    @property
    def values(self) -> Floats:
        """By frame and judged camera, shape (frames, cameras)."""
        return np.array(self.judged)

    @property
    def oracle_values(self) -> Floats:
        """The largest value by frame and judged camera, shape (frames, cameras)."""
        return self._interpolated(lambda best: best.metrics)

    @property
    def oracle_levels(self) -> Floats:
        """The best level of each frame, stops."""
        return self._interpolated(lambda best: (best.level,))[:, 0]

    @property
    def ratios(self) -> Floats:
        """The value as a share of the oracle's by frame; NaN where no exposure shows anything."""
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = np.mean(self.values / self.oracle_values, axis=1)
        return np.asarray(shares / self._interpolated(lambda best: (best.joint,))[:, 0])

    def _interpolated(self, value: Callable[[Best], tuple[float, ...]]) -> Floats:
        """Values of the oracle's answers at all frames, shape (frames, values)."""
        known = {frame: value(best) for frame, best in self.best.items() if best is not None}
        if not known:
            return np.full(self.values.shape, np.nan)
        columns = np.array(list(known.values())).T
        return np.stack([np.interp(np.arange(len(self.judged)), list(known), column) for column in columns], axis=1)


@dataclass(slots=True, eq=False)
class Series:
    """What one entrant did in one course: float64 arrays of shape (frames,), unless stated otherwise."""

    entrant: Entrant
    first_scored: int
    delayed: DelayedLoop
    # by_metric, by_objective: how its frames do by M_g, and by what its policy maximises; the same unless that is
    # information.
    by_metric: Judgement
    by_objective: Judgement
    by_any_split: Judgement  # by M_g, against the best of all exposure times and gains
    # Information of each frame and the one before it as a share of the most; NaN for the first.
    pair_shares: list[float] = field(default_factory=list)

    @property
    def levels(self) -> Floats:
        """Exposure level of each frame, stops."""
        return np.array([setting.level for setting in self.delayed.settings])

    @property
    def gains_db(self) -> Floats:
        """Gain of each frame."""
        return np.array([setting.gain_db for setting in self.delayed.settings])

    @property
    def metrics(self) -> Floats:
        """M_g by frame and judged camera, shape (frames, cameras)."""
        return self.by_metric.values

    @property
    def clipped_shares(self) -> Floats:
        """Share of black and saturated pixels, together, in each left image."""
        return np.array([decision.saturated_share + decision.black_share for decision in self.delayed.decisions])

    @property
    def oracle_levels(self) -> Floats:
        """The level of each frame that is best by what the policy maximises, stops."""
        return self.by_objective.oracle_levels

    @property
    def ratios(self) -> Floats:
        """What the policy maximises, as a share of the oracle's; NaN where no exposure shows anything."""
        return self.by_objective.ratios

    def score(self) -> CourseScore:
        """The scores of this run."""
        return score(
            levels=self.levels, oracle_levels=self.oracle_levels, ratios=self.ratios,
            metric_ratios=self.by_metric.ratios, any_split_ratios=self.by_any_split.ratios,
            pair_ratios=np.array(self.pair_shares), clipped_shares=self.clipped_shares, gains_db=self.gains_db,
            first_scored=self.first_scored,
        )  # fmt: skip


def run_course(
    scenario: str, scene: str, seed: int, entrants: Sequence[Entrant], *, frames: int | None = None
) -> list[Series]:
    """Take all entrants through one course, each in its own closed loop. `entrants`: who runs; no result depends on the
    other entrants. `frames`: stop after this many frames; None for the whole scenario."""
    stage, first_scored = course_of(scenario, scene, seed)
    # One exposure serves both cameras; where they see different things, both are judged.
    cameras: tuple[CameraName, ...] = ("left", "right") if stage.has_lamp else ("left",)
    kind = SCENARIOS[scenario]
    return race(
        stage, entrants, Oracle(stage, cameras), Oracle(stage, cameras, "information"), frames=frames or kind.frames,
        first_scored=first_scored, every=kind.oracle_every,
    )  # fmt: skip


def course_of(scenario: str, scene: str, seed: int, response: str = "linear") -> tuple[Stage, int]:
    """The stage of one course, seen by sensors with a response function, and its first scored frame."""
    kind = SCENARIOS[scenario]
    course = kind.draw(np.random.default_rng([seed, list(SCENARIOS).index(scenario)]))
    views = build_views(scene, seed, course.gaze, kind.at_window)
    return Stage(views, course, seed, response=response), course.first_scored


def race(
    stage: Stage,
    entrants: Sequence[Entrant],
    oracle: Oracle,
    informed: Oracle | None = None,
    *,
    frames: int,
    first_scored: int,
    every: int,
) -> list[Series]:
    """Take all entrants through the first `frames` frames of a stage, starting from the best exposure of the first. The
    oracles are asked about one frame in `every`, about the last one, and where the light jumps: that of M_g for all
    entrants, and that of Fisher information, if given, for those that maximise it. Every fourth time that of M_g is
    asked for the best of all splits, too."""
    start = best_start(oracle)
    any_split: dict[int, Best | None] = {}
    race = [_enter(entrant, start, first_scored, informed, any_split) for entrant in entrants]
    pairs = SuccessiveFrames(stage)
    for frame in range(frames):
        stage.go_to(frame)
        always = frame == frames - 1 or _light_jumps_at(stage, frame, frames)
        asked = always or frame % every == 0
        if always or frame % (SPLITS_EVERY * every) == 0:
            any_split[frame] = oracle.best_of_all()
        for series in race:
            taken = series.delayed.step(stage.take).reference.setting
            series.pair_shares.append(pairs.share(series.delayed.settings[-2], taken) if frame else math.nan)
            judges = [(series.by_metric, oracle)]
            if informed is not None and series.by_objective is not series.by_metric:
                judges.append((series.by_objective, informed))
            for judgement, judge in judges:
                judgement.judged.append(judge.judge(taken))
                if asked:
                    motion_px = series.delayed.decisions[-1].motion_px
                    judgement.best[frame] = judge.best(series.delayed.loop.balance, motion_px)
    return race


def _enter(
    entrant: Entrant,
    start: ExposureSetting,
    first_scored: int,
    informed: Oracle | None,
    any_split: dict[int, Best | None],
) -> Series:
    delayed, by_metric = entrant.enter(start), Judgement()
    own = delayed.loop.objective == "information" and informed is not None
    by_any_split = Judgement(by_metric.judged, any_split)
    return Series(entrant, first_scored, delayed, by_metric, Judgement() if own else by_metric, by_any_split)


def _light_jumps_at(stage: Stage, frame: int, frames: int) -> bool:
    def jump(first: int) -> bool:
        lights = zip(stage.glimpse_lux(max(first, 0)), stage.glimpse_lux(first + 1), strict=True)
        return any(abs(math.log2((after + 1e-6) / (before + 1e-6))) > LIGHT_JUMP_STOPS for before, after in lights)

    return jump(frame - 1) or (frame + 1 < frames and jump(frame))
