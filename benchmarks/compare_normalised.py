"""What frames brought to one exposure are worth to ORB, SIFT and KLT when the exposure changes: docs/frames-out.md.

python benchmarks/compare_normalised.py [stills] [loop] [apart]
"""

from __future__ import annotations

import math
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from autoexpose_daemon.client import ReceivedPair, alike
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.worth.matches.judge import (
    FEWEST_INLIERS,
    PREPARATIONS,
    SeenFrame,
    klt_motion,
    orb_motion,
    seen,
    sift_inliers,
)
from evaluation.experiments.worth.matches.scenes import Similarity, TrueMotion
from evaluation.scenes.scenarios import RATE_HZ, SCENARIOS, Course, steady
from evaluation.scenes.stills import PAINTERS
from evaluation.scenes.views import CAMERA, Gaze, build_views
from evaluation.stage.camera import Entrant
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import Stage
from imaging.exposure import ExposureSetting
from imaging.frames import Side, StereoPair
from imaging.response import ResponseFunction

LOOP_SCENARIOS = ("step_up", "step_down", "pan", "tunnel", "sun_shadow")

CHANGES = (0.0, 0.25, 0.5, 1.0, 2.0)
"""Stops between consecutive frames."""

CHANGED_STOPS = 0.1
"""In closed loop: exposures that differ by more have changed, and so has light."""

LUX, MEAN_GREY = 150.0, 80.0
"""Light on the stills, and the mean grey level at least of the exposure that the others alternate around."""

SPEEDS_PX = (4.0, 24.0)
"""From frame to frame. The arena's fastest pan has 15."""

FRAMES = 3
"""Of a still."""

APART_SCENARIOS, APART_FRAMES = ("pan", "sun_shadow"), 12

LOOP_FRAMES, LOOP_PAIRS = 120, 6
"""Of a course: scored frames, and how many of the pairs whose exposure has changed are matched, evenly spread."""

SEED, NOISE_SEED = 7, 3

JUDGES: dict[str, Callable[[SeenFrame, SeenFrame, TrueMotion], int]] = {
    "ORB": lambda first, second, truth: orb_motion(first, second, truth).inliers,
    "SIFT": sift_inliers,
    "KLT": lambda first, second, truth: klt_motion(first, second, truth).inliers,
}

LINEAR = ResponseFunction.linear()
RESPONSES: dict[Side, ResponseFunction] = {"left": LINEAR, "right": LINEAR}


def received(pair: StereoPair) -> ReceivedPair:
    """A pair as a client with `normalised` hands it out."""
    return ReceivedPair(pair.frames["left"], pair.frames.get("right"), 0, 1, 1, None, 0, RESPONSES)


def longer(setting: ExposureSetting, stops: float) -> ExposureSetting:
    return ExposureSetting(setting.exposure_time_us * 2.0**stops, setting.gain_db)


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """A frame, with the light and the place in the middle of its exposure."""

    pair: ReceivedPair
    raw: dict[str, SeenFrame]
    lux: float
    at_px: float

    @classmethod
    def of(cls, pair: StereoPair, stage: Stage, gaze: Gaze) -> Taken:
        exposure_s, start_s = pair.frames["left"].setting.exposure_time_us / 1e6, stage.start_s(stage.frame)
        lux, at_px = stage.light.mean_lux(start_s, exposure_s), CAMERA.focal_px * gaze(start_s + exposure_s / 2)
        return cls(received(pair), seen(pair.frames["left"].grey8()), lux, at_px)

    def brought_to(self, level: float) -> dict[str, SeenFrame]:
        """What is seen in this frame at another exposure level."""
        return self.raw if level == self.pair.level else seen(np.asarray(self.pair.normalised(level).left, np.uint8))


class Inliers:
    """Matches that agree with the true motion: of raw frames, of frames brought to one exposure, of frames alike."""

    def __init__(self) -> None:
        self._counts: dict[str, list[tuple[int, ...]]] = defaultdict(list)
        self._brought: list[bool] = []

    def match(self, first: Taken, second: Taken) -> None:
        """Match two frames between which the scene has moved along the rows."""
        truth = TrueMotion(np.array([[1.0, 0.0, second.at_px - first.at_px], [0, 1, 0], [0, 0, 1]]), Similarity())
        brightest = max(first.pair.level, second.pair.level)
        raw = first.raw, second.raw
        brought = first.brought_to(brightest), second.brought_to(brightest)
        here, there = alike(first.pair, second.pair)
        self._brought.append(here.reference == there.reference)
        for name, judge in JUDGES.items():
            for kind in PREPARATIONS:
                counts = [judge(before[kind], after[kind], truth) for before, after in (raw, brought)]
                self._counts[f"{name} {kind}"].append((*counts, counts[self._brought[-1]]))

    def add(self, more: Inliers) -> None:
        self._brought += more._brought
        for name, counts in more._counts.items():
            self._counts[name] += counts

    def lines(self) -> Iterator[str]:
        """Mean inliers, and in brackets the pairs with fewer than `FEWEST_INLIERS`."""
        yield f"{len(self._brought)} pairs, of which `alike` brings {sum(self._brought)} to one exposure"
        if self._brought:
            yield f"{'':22}{'raw':>9}  {'brought':>9}  {'alike':>9}"
        for name, counts in self._counts.items():
            table = np.array(counts)
            means, lost = table.mean(axis=0), (table < FEWEST_INLIERS).sum(axis=0)
            cells = (f"{mean:4.0f} ({few:2d})" for mean, few in zip(means, lost, strict=True))
            yield f"    {name:18}" + "  ".join(f"{cell:>9}" for cell in cells)


def stills() -> Iterator[str]:
    """Exposures that alternate, on painted stills."""
    for speed_px in SPEEDS_PX:
        for change in CHANGES:
            inliers = Inliers()
            for painter in PAINTERS:
                _alternate(inliers, painter, speed_px, change)
            yield f"{speed_px:.0f} px, {change:.2f} stops"
            yield from inliers.lines()


def _alternate(inliers: Inliers, painter: str, speed_px: float, change: float) -> None:
    def gaze(time_s: float) -> float:
        return speed_px / CAMERA.focal_px * RATE_HZ * time_s

    stage = Stage(build_views(painter, SEED, gaze, False), Course(steady(LUX), gaze, 0), NOISE_SEED)
    middle = _bright_enough(stage)
    taken = []
    for frame in range(FRAMES):
        stage.go_to(frame)
        taken.append(Taken.of(stage.take(longer(middle, (-1) ** frame * change / 2), ["left"]), stage, gaze))
    for first, second in pairwise(taken):
        inliers.match(first, second)


def _bright_enough(stage: Stage) -> ExposureSetting:
    setting = ExposureSetting(50.0, 0.0)
    while stage.expose("left", setting).mean() < MEAN_GREY:
        setting = longer(setting, 0.25)
    return setting


def loop() -> Iterator[str]:
    """A policy in closed loop, on painted stills: successive frames between which the exposure changed."""
    return _looped(LOOP_SCENARIOS, 1)


def apart() -> Iterator[str]:
    """The same of frames that are further apart, as key frames are."""
    return _looped(APART_SCENARIOS, APART_FRAMES)


def _looped(scenarios: Sequence[str], apart_frames: int) -> Iterator[str]:
    every = Inliers(), Inliers()
    for name in scenarios:
        of_scenario = Inliers(), Inliers()
        for painter in PAINTERS:
            pairs = _changes(name, painter, apart_frames)
            for place in np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), LOOP_PAIRS)).astype(int)):
                first, second = pairs[place]
                lit = abs(math.log2(second.lux / first.lux)) > CHANGED_STOPS
                of_scenario[lit].match(first, second)
        for inliers, more in zip(every, of_scenario, strict=True):
            inliers.add(more)
        yield from _split(name, of_scenario)
    yield from _split("all", every)


def _split(name: str, inliers: tuple[Inliers, Inliers]) -> Iterator[str]:
    for of_light, what in zip(inliers, ("the light did not change", "the light changed, too"), strict=True):
        yield f"{name}, {what}"
        yield from of_light.lines()


def _changes(name: str, painter: str, apart_frames: int) -> list[tuple[Taken, Taken]]:
    """Frames of one course, so many frames apart, between which the exposure changed; the second one is scored."""
    scenario = SCENARIOS[name]
    course = scenario.draw(np.random.default_rng(SEED))
    stage = Stage(build_views(painter, SEED, course.gaze, scenario.at_window), course, NOISE_SEED)
    delayed = Entrant.of(DEFAULT_POLICY).enter(best_start(Oracle(stage)))
    taken: list[Taken] = []
    for frame in range(course.first_scored + LOOP_FRAMES):
        stage.go_to(frame)
        taken.append(Taken.of(delayed.step(stage.take), stage, course.gaze))
    return [
        (before, now)
        for before, now in zip(taken[course.first_scored - apart_frames :], taken[course.first_scored :], strict=False)
        if abs(now.pair.level - before.pair.level) > CHANGED_STOPS
    ]


Parts = Mapping[str, Callable[[], Iterator[str]]]

PARTS: Parts = {"stills": stills, "loop": loop, "apart": apart}


def print_parts(parts: Parts, names: Iterable[str]) -> None:
    cv2.setNumThreads(1)
    for name in names:
        print(name, flush=True)
        for line in parts[name]():
            print("   ", line, flush=True)


if __name__ == "__main__":
    print_parts(PARTS, sys.argv[1:] or PARTS)
