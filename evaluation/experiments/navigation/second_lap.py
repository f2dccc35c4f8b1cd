"""A second lap through light that a first one saw: frames lost with and without what was remembered of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final, Literal

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.step import StepInputs
from evaluation.arena.race import Series, race
from evaluation.arrays import Floats, Ints
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table
from evaluation.jobs.job import Job, Plain
from evaluation.prose import text_beside
from evaluation.scenes.scenarios import RATE_HZ, WARM_UP_FRAMES, Course, steady
from evaluation.scenes.views import Gaze, build_views
from evaluation.stage.camera import Entrant
from evaluation.stage.oracle import Oracle
from evaluation.stage.rendering import Stage
from fake_camera.world.lighting import Change, LightScript
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import FrameSet
from imaging.response import ResponseFunction
from navigation.maps.path import SPREAD_M, LightMemory, LightTrail

# Seconds that the light takes to fall or rise where a robot drives in or out.
MOUTHS: Final[dict[str, float]] = {"tunnel": 1.0, "underpass": 0.25, "door": 0.06}
WINDOW: Final = "window"  # The robot turns past a window and back, in steady light
SPEED_M_S: Final = 1.0
FRAMES: Final = 480
LUX, LATER = 800.0, 1.0 / 3.0  # Light of the first lap, and its share on the second
BAD: Final = 0.5  # A frame that is worth less than this share of what the best exposure gives is bad
# By how much the second lap looks to the side of where the first one looked, to and fro: two degrees.
ASIDE_RAD: Final = 0.035
WANDERING_FRAMES: Final = 30  # The error of the place on the way changes this slowly
WRONG_M: Final = 3.0  # How much further on a robot believes to be that is told wrong
DELAYS: Final = (2, 4, 8)
SCENES: Final = (("shelves", 3000), ("hall", 3000), ("room", 3001), ("room", 3002))  # Tried on seeds 1 to 18 only
LAPS: Final = ("first", "second", "second, told", "second, told wrong")


class Remembering(ControlLoop):
    """Keeps what the product keeps of a lap."""

    def __init__(self, response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> None:
        super().__init__(DEFAULT_POLICY, response, limits, start)
        self._trail = LightTrail()

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        """The next decision."""
        decision = super().step(inputs)
        pair = StepInputs.of(inputs).pair
        pair = StepInputs.of(inputs).pair
        self._trail.see(_driven_m(pair), pair.frames["left"], self.setup.responses["left"])
        return decision

    def memory(self) -> LightMemory:
        """The light of the lap so far."""
        return LightMemory.of(self._trail.new_rows(ended=True))


class Told(ControlLoop):
    """Is told, with every frame, what a lap saw around where it believes to be."""

    def __init__(
        self,
        memory: LightMemory,
        error_m: Floats,
        response: ResponseFunction,
        limits: ExposureLimits,
        start: ExposureSetting,
    ) -> None:
        super().__init__(DEFAULT_POLICY, response, limits, start)
        self._memory, self._error_m = memory, error_m

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        """The next decision."""
        inputs = StepInputs.of(inputs)
        pair = inputs.pair
        distance_m = _driven_m(pair) + float(self._error_m[pair.trigger])
        series = self._memory.series(distance_m, SPEED_M_S)
        told = None if series is None else series.in_frames(0.0, RATE_HZ)
        return super().step(replace(inputs, light_ahead=inputs.light_ahead or told))


def _driven_m(pair: FrameSet) -> float:
    """How far along the path a pair was taken; triggers count frames from 0."""
    return pair.trigger / RATE_HZ * SPEED_M_S


@dataclass(frozen=True, slots=True)
class Way:
    """A scenario in a scene, as long as a lap."""

    scenario: str
    scene: str
    seed: int
    frames: int

    def first(self, delay: int) -> tuple[Series, LightMemory]:
        """The lap in which the light is seen first."""
        (series,) = self._drive(self._course(1.0), [Entrant("first", delay, Remembering)], self.seed)
        loop = series.delayed.loop
        assert isinstance(loop, Remembering)
        return series, loop.memory()

    def second(self, entrants: list[Entrant]) -> list[Series]:
        """A lap of each entrant at another hour: a share of the light, the gaze a little aside, and other noise."""
        course, phase = self._course(LATER), float(np.random.default_rng([self.seed, 1]).uniform(0.0, 2 * math.pi))
        gaze = course.gaze

        def aside(s: float) -> float:
            return gaze(s) + ASIDE_RAD * math.sin(2 * math.pi * 0.37 * s + phase)

        return self._drive(replace(course, gaze=aside), entrants, self.seed + 1)

    def _course(self, share: float) -> Course:
        return _course(self.scenario, np.random.default_rng(self.seed), share)

    def _drive(self, course: Course, entrants: list[Entrant], noise_seed: int) -> list[Series]:
        views = build_views(self.scene, self.seed, course.gaze, self.scenario == WINDOW)
        stage = Stage(views, course, noise_seed)
        oracles = [Oracle(stage, ("left",), by) for by in ("metric", "information")]
        every = 2 if self.scenario == WINDOW else 16  # frames: the best exposure changes as fast as the view
        return race(stage, entrants, *oracles, frames=self.frames, first_scored=course.first_scored, every=every)


def measure_second_lap(scenario: str, scene: str, seed: int, delay: int, frames: int = FRAMES) -> Plain:
    """Bad frames and the mean worth of all frames, for each of `LAPS`."""
    way = Way(scenario, scene, seed, frames)
    first, memory = way.first(delay)
    error_m = _wandering(np.random.default_rng([seed, delay]), frames)
    entrants = [
        Entrant.of(DEFAULT_POLICY, delay),
        Entrant("told", delay, partial(Told, memory, error_m)),
        Entrant("told wrong", delay, partial(Told, memory, error_m + WRONG_M)),
    ]
    return [_outcome(lap) for lap in (first, *way.second(entrants))]


def _outcome(series: Series) -> Plain:
    ratios = series.ratios[series.first_scored :]
    return {"bad": int((ratios < BAD).sum()), "mean": float(np.nanmean(ratios))}


def _wandering(rng: np.random.Generator, frames: int) -> Floats:
    """Errors of the distance along the way, m, as large as the product takes them to be."""
    kept = math.exp(-1.0 / WANDERING_FRAMES)
    errors, error = [], float(rng.normal())
    for _ in range(frames):
        error = kept * error + math.sqrt(1.0 - kept**2) * float(rng.normal())
        errors.append(error)
    return SPREAD_M * np.array(errors)


def _course(scenario: str, rng: np.random.Generator, share: float) -> Course:
    sway = _sway(rng)
    if scenario != WINDOW:
        return Course(_light(MOUTHS[scenario], rng, LUX * share), sway, WARM_UP_FRAMES)
    amplitude, period_s = rng.uniform(0.9, 1.05), rng.uniform(3.6, 4.4)
    lux = float(rng.uniform(3.0, 6.0)) * (0.5 + share)
    return Course(steady(lux), lambda s: amplitude * math.cos(2 * math.pi * s / period_s), WARM_UP_FRAMES)


def _sway(rng: np.random.Generator) -> Gaze:
    amplitude, phase = 0.3 * rng.uniform(0.85, 1.0), rng.uniform(0.0, 2 * math.pi)
    return lambda s: amplitude * math.sin(2 * math.pi * 0.2 * s + phase)


def _light(mouth_s: float, rng: np.random.Generator, lux: float) -> LightScript:
    """Shade of trees, then twice in and out of the dark, with the sun in between."""
    changes = [Change(0.0, lux)]
    time_s, stop = 0.0, 0.0
    for pause_s, target, takes_s in _events(mouth_s, rng):
        time_s += pause_s
        pieces = max(1, round(abs(target - stop)))
        for piece in range(pieces):
            level = stop + (target - stop) * (piece + 1) / pieces
            begin_s = time_s + piece * takes_s / pieces
            changes.append(Change(begin_s + 1e-9, lux * 2.0**level, takes_s / pieces - 2e-9))
        time_s, stop = time_s + takes_s, target
    return LightScript(tuple(changes))


def _events(mouth_s: float, rng: np.random.Generator) -> Iterator[tuple[float, float, float]]:
    """Pause, stops, and seconds that the change takes."""
    shade = -float(rng.uniform(1.5, 2.5))
    yield float(rng.uniform(0.7, 1.3)), shade, 0.15
    yield float(rng.uniform(0.2, 0.5)), 0.0, 0.15
    for deepest in (-8.0, -6.0):
        yield float(rng.uniform(0.3, 0.7)), deepest, mouth_s
        yield float(rng.uniform(0.5, 0.9)), 0.0, mouth_s


def jobs(quick: bool) -> list[Job]:
    """Each scenario with each delay in each scene; a quick run has one, cut short after the first tunnel."""
    if quick:
        arguments: dict[str, Plain] = {"scenario": "underpass", "scene": "room", "seed": 1, "delay": 8, "frames": 240}
        return [Job(measure_second_lap, arguments, 30.0, (DEFAULT_POLICY,))]
    cases: list[dict[str, Plain]] = [
        {"scenario": scenario, "scene": scene, "seed": seed, "delay": delay}
        for scenario, (scene, seed), delay in product((*MOUTHS, WINDOW), SCENES, DELAYS)
    ]
    return [Job(measure_second_lap, case, 60.0, (DEFAULT_POLICY,)) for case in cases]


@dataclass
class _Case:
    """All scenes of one scenario and delay: bad frames by lap, summed, and mean worth by lap and scene."""

    bad: Ints = field(default_factory=lambda: np.zeros(len(LAPS), np.int64))
    means: list[list[float]] = field(default_factory=list)


def _cases(results: Results) -> dict[tuple[str, int], _Case]:
    cases: dict[tuple[str, int], _Case] = {}
    for arguments, laps in results:
        case = cases.setdefault((str(arguments["scenario"]), int(str(arguments["delay"]))), _Case())
        case.bad += np.array([lap["bad"] for lap in laps])
        case.means.append([lap["mean"] for lap in laps])
    return cases


def section(results: Results, _folder: Path) -> ReportSection:
    """Bad frames and worth, by scenario and delay."""
    rows = []
    for (scenario, delay), case in _cases(results).items():
        worth = [f"{mean:.3f}" for mean in np.mean(case.means, axis=0)]
        rows.append([scenario, str(delay), *map(str, case.bad), *worth])
    columns = ["scenario", "delay", *(f"bad: {lap}" for lap in LAPS), *(f"worth: {lap}" for lap in LAPS)]
    parts: list[Table | Figure] = [Table("Bad frames, all scenes together, and mean worth of a frame.", columns, rows)]
    return ReportSection(
        text_beside(
            __file__,
            seconds=FRAMES / RATE_HZ,
            speed_m_s=SPEED_M_S,
            rate_hz=RATE_HZ,
            later=LATER,
            second_share=(0.5 + LATER) / 1.5,
            spread_m=SPREAD_M,
            wrong_m=WRONG_M,
            bad=BAD,
        ),
        list(_claims(results)),
        parts,
    )


def _claims(results: Results) -> Iterator[Claim]:
    by_case = _cases(results)
    by_scenario: dict[str, Ints] = {}
    for (scenario, _), case in by_case.items():
        by_scenario[scenario] = by_scenario.get(scenario, 0) + case.bad
    yield _halving(by_scenario, 0, "scenario")
    by_delay = {f"{scenario}, {delay}": case.bad for (scenario, delay), case in by_case.items()}
    yield _halving(by_delay, 1, "scenario and delay")
    cases = by_case.values()
    worst = min(float(np.mean([means[3] - means[1] for means in case.means])) for case in cases)
    claim, ours = "to be told wrong costs at most 0.005 of the worth", f"{worst:+.3f} in the worst scenario and delay"
    yield Claim.of_this_project(claim, ours, holds=worst >= -0.005)


def _halving(bad: dict[str, Ints], lap: int, each: str) -> Claim:
    """The claim that a lap which is told has at most half of the bad frames of another, of `LAPS`, in each of `bad`."""
    return Claim.of_this_project(
        f"what was remembered halves the bad frames of the {LAPS[lap]} lap in every {each}",
        "; ".join(f"{name}: {frames[2]} of {frames[lap]}" for name, frames in bad.items()),
        holds=all(frames[2] <= 0.5 * frames[lap] for frames in bad.values()),
    )


BETTER: Final[dict[str, Literal["higher", "lower"]]] = {"bad-frames": "lower", "worth": "higher"}


def data(results: Results) -> Plain:
    """For `--json`."""
    rows: list[Plain] = []
    for arguments, laps in results:
        course = "{scenario}, {scene} {seed}, delay {delay}".format_map(arguments)
        for name, lap in zip(LAPS, laps, strict=True):
            base = {"course": course, "policy": f"{DEFAULT_POLICY}, {name}"}
            values = zip(BETTER, (lap["bad"], lap["mean"]), strict=True)
            rows += [{"judge": judge, **base, "value": value} for judge, value in values]
    return {"default_policy": DEFAULT_POLICY, "better": dict(BETTER), "results": rows}


EXPERIMENT = Experiment("second-lap", "Light that was seen before (ours)", jobs, section, data)  # Not in the papers
