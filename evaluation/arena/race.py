"""Policies in closed loop and virtual time, side by side through one course, against the best exposure.

Several variants through the same course share rendering and oracles: far cheaper than one by one.

    mine = Entrant("variant-a", 2, lambda response, limits, start: make_my_control_loop(response, limits, start))
    for series in run_course("tunnel", "leaves", 3, [Entrant.of("begin2022"), mine]):
        series.levels, series.metrics, series.ratios        # one value per frame
        series.score()                                      # settle_frames, metric_ratio_mean, ...

Scenarios: `scenarios.SCENARIOS`; scenes and seeds for tuning: `plan.TUNE_SCENES`, 0 to 99. Not for two threads at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from evaluation.arena.scores import CourseScore, SuccessiveFrames, score
from evaluation.arrays import Floats
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.scenes.views import build_views
from evaluation.stage.camera import DelayedLoop, Entrant
from evaluation.stage.oracle import Best, Oracle, best_start
from evaluation.stage.rendering import Stage
from fake_camera.world.simulation import Side
from imaging.exposure import ExposureSetting

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
    """Take all entrants through one course, each in its own closed loop. `scenario`, `scene`, `seed`: the course.
    `entrants`: who runs; no result depends on the other entrants. `frames`: stop after this many frames; None for the
    whole scenario."""
    stage, first_scored = course_of(scenario, scene, seed)
    # One exposure serves both cameras; where they see different things, both are judged.
    sides: tuple[Side, ...] = ("left", "right") if stage.has_lamp else ("left",)
    kind = SCENARIOS[scenario]
    return race(
        stage, entrants, Oracle(stage, sides), Oracle(stage, sides, "information"), frames=frames or kind.frames,
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
