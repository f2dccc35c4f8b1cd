"""What it is worth to be steered by consumers: half a picture in the sun, and a drive by odometry."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.inputs import COLUMNS, ROWS, TrackedCells, count_by_cell
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import contrast
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.picture.steering import STEERING_SHARE, CellExposure, TrackingMemory
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.step import StepInputs
from evaluation.arrays import Floats, Floats32, Greys
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table
from evaluation.jobs.job import Job, Plain
from evaluation.odometry.orb import in_house
from evaluation.odometry.stereo import images, prepared
from evaluation.odometry.tracking import EVERY, Light, odometry_stage, outcome, track_entrants
from evaluation.prose import text_beside
from evaluation.scenes.scenarios import RATE_HZ, WARM_UP_FRAMES, Course, steady
from evaluation.scenes.views import Scene, build_views
from evaluation.stage.camera import Entrant, Image
from evaluation.stage.oracle import Information, Oracle, best_start
from evaluation.stage.rendering import Stage
from imaging.exposure import ExposureLimits, ExposureSetting, linear_gain
from imaging.frames import FrameSet
from imaging.response import ResponseFunction

LATENCY_FRAMES: Final = 3  # From a frame to the decision that its report steers first
FEATURES, FAST_THRESHOLD = 800, 12
# Of a match: in bits of its descriptor, and from where the median of all matches puts it.
LARGEST_DISTANCE, ASTRAY_PX = 64, 3.0
Half = Literal["left", "right"]
# The cells of each half of the picture.
HALVES: Final = {"left": np.s_[:, : COLUMNS // 2], "right": np.s_[:, COLUMNS // 2 :]}
Cells = NDArray[np.uint16]


class Consumer(Protocol):
    """Says of each pair how many features it looked for in each cell of the left frame, and how many it tracked."""

    def track(self, pair: FrameSet) -> tuple[Cells, Cells] | None:
        """Features and inliers; None: no report."""


class Orb:
    """ORB from frame to frame: inliers are matches that moved as most did."""

    def __init__(self) -> None:
        self._orb = cv2.ORB.create(FEATURES, fastThreshold=FAST_THRESHOLD)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        self._before: tuple[Floats, Greys] | None = None

    def track(self, pair: FrameSet) -> tuple[Cells, Cells]:
        """See `Consumer`."""
        image = prepared(pair.reference.grey8())
        found, descriptors = self._orb.detectAndCompute(image, None)
        points = np.array([feature.pt for feature in found], np.float64).reshape(-1, 2)
        followed = points[:0]
        if self._before is not None and len(points) and len(self._before[0]):
            matches = self._matcher.match(np.asarray(descriptors, np.uint8), self._before[1])
            near = [(match.queryIdx, match.trainIdx) for match in matches if match.distance <= LARGEST_DISTANCE]
            here, there = np.array(near, np.intp).reshape(-1, 2).T
            moved = points[here] - self._before[0][there]
            if len(moved):
                followed = points[here[np.abs(moved - np.median(moved, axis=0)).max(axis=1) < ASTRAY_PX]]
        self._before = points, np.asarray(descriptors if len(points) else np.empty((0, 32)), np.uint8)
        rows, columns = image.shape
        return count_by_cell(points, columns, rows), count_by_cell(followed, columns, rows)


class Caring:
    """Looks for features everywhere and has a use for those in one half, as if all else moved by itself."""

    def __init__(self, half: Half, frames: int | None = None) -> None:
        self._orb = Orb()
        self._others: Half = "right" if half == "left" else "left"
        self._frames = frames

    def track(self, pair: FrameSet) -> tuple[Cells, Cells] | None:
        """See `Consumer`; silent after so many frames."""
        features, inliers = self._orb.track(pair)
        inliers[HALVES[self._others]] = 0
        return None if self._frames is not None and pair.trigger >= self._frames else (features, inliers)


class Liar:
    """Claims to track all of one half and nothing of the other, whatever the picture shows."""

    def __init__(self, half: Half) -> None:
        self._features = np.full((ROWS, COLUMNS), 20, np.uint16)
        self._inliers = np.zeros((ROWS, COLUMNS), np.uint16)
        self._inliers[HALVES[half]] = 20

    def track(self, _pair: FrameSet) -> tuple[Cells, Cells]:
        """See `Consumer`."""
        return self._features, self._inliers


class Steered(ControlLoop):
    """The default policy, steered by one consumer that reports on every `every`th frame."""

    def __init__(
        self, consumer: Consumer, every: int, response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting
    ) -> None:
        super().__init__(DEFAULT_POLICY, response, limits, start)
        self._consumer, self._every = consumer, every
        self._memory = TrackingMemory()
        self._on_the_way: deque[tuple[int, TrackedCells, CellExposure, float]] = deque()

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        """The next decision."""
        inputs = StepInputs.of(inputs)
        pair = inputs.pair
        now_s = pair.reference.host_time_ns * 1e-9
        while self._on_the_way and self._on_the_way[0][0] <= pair.trigger:
            self._memory.take(*self._on_the_way.popleft()[1:])
        known = inputs.steering or self._memory.steering(now_s)
        decision = super().step(replace(inputs, steering=known))
        if pair.trigger % self._every == 0 and (counts := self._consumer.track(pair)) is not None:
            report = TrackedCells("consumer", 0, "left", *counts)
            arrives = pair.trigger + LATENCY_FRAMES
            self._on_the_way.append((arrives, report, self.cell_exposures["left"], now_s))
        return decision


NAMES = ("alone", "steered")


class OdometryConsumer:
    """The in-house odometry."""

    def __init__(self) -> None:
        self._odometry = in_house()

    def track(self, pair: FrameSet) -> tuple[Cells, Cells]:
        """See `Consumer`."""
        self._odometry.track(*images(pair))
        height, width = pair.reference.pixels.shape
        features = count_by_cell(self._odometry.features_px, width, height)
        return features, np.minimum(count_by_cell(self._odometry.inliers_px, width, height), features)


def measure_drive(*, light: Light, room: int, frames: int) -> Plain:
    """For each of `NAMES`: error of odometry, lost pairs, and how many points tie a pair to the last key pair."""
    entrants = [Entrant.of(DEFAULT_POLICY), Entrant("steered", 2, _steered)]
    inliers: list[list[int]] = [[] for _ in entrants]

    def look(number: int, _pair: FrameSet) -> None:
        inliers[number].append(len(odometries[number].inliers_px))

    odometries = [in_house() for _ in entrants]
    waiting = iter(odometries)
    made = track_entrants(odometry_stage(light, room, room, 0), entrants, lambda: next(waiting), frames, look)
    return [
        {key: outcome(one)[key] for key in ("rpe_mm", "lost_share", "failed", "metric")}
        | {"inliers": float(np.mean(of)), "level": float(np.mean([each.level for each in one.delayed.settings]))}
        for one, of in zip(made, inliers, strict=True)
    ]


def _steered(response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> Steered:
    return Steered(OdometryConsumer(), EVERY, response, limits, start)


LUX: Final = 60.0
EDGE: Final = 0.1  # Half the width of the edge of the shade, as a share of the picture's
SWAY_RAD, SWAY_HZ = 0.05, 0.3
PARTS: Final = ("left", "right", "whole")
_MARGIN = 12


class SunAndShade:
    """A view whose left half is brighter than its right one by `stops`, from `swap_s` on the other way round."""

    def __init__(self, view: Scene, stops: float, swap_s: float) -> None:
        self._view, self._stops, self._swap_s = view, stops, swap_s

    def image_shift_px(self, start_s: float, end_s: float) -> float:
        """See `Scene`."""
        return self._view.image_shift_px(start_s, end_s)

    def radiance(self, times_s: Floats, lux: float) -> Floats32:
        """See `Scene`."""
        radiance = self._view.radiance(times_s, lux)
        across = np.clip(np.linspace(-1.0, 1.0, radiance.shape[1]) / EDGE, -1.0, 1.0)
        sign = -0.5 if times_s[0] < self._swap_s else 0.5
        return np.asarray(radiance * np.exp2(sign * self._stops * across), np.float32)


def stage_of(scene: str, seed: int, stops: float, swap_s: float) -> Stage:
    """A still scene that sways, half in the sun."""

    def gaze(time_s: float) -> float:
        return SWAY_RAD * math.sin(2 * math.pi * SWAY_HZ * time_s)

    views = build_views(scene, seed, gaze, at_window=False)
    halved: dict[str, Scene] = {camera: SunAndShade(view, stops, swap_s) for camera, view in views.items()}
    return Stage({"left": halved["left"], "right": halved["right"]}, Course(steady(LUX), gaze, 0), seed)


class HalvesJudge:
    """What frames are worth: their Fisher information, as the default policy counts it."""

    def __init__(self) -> None:
        self._preparation = ImagePreparation()
        self._information = Information(ResponseFunction.linear())

    def worth(self, image: Image, setting: ExposureSetting) -> dict[str, float]:
        """Of each of `PARTS`."""
        pixels = image.size / self._preparation.prepare(image).size
        seen, gain = self._preparation.unfiltered, linear_gain(setting.gain_db)
        worth = {}
        for part in PARTS:
            weights = np.full(seen.shape, 255, np.uint8)
            middle = seen.shape[1] // 2
            if part == "left":
                weights[:, middle - _MARGIN :] = 0
            elif part == "right":
                weights[:, : middle + _MARGIN] = 0
            found = contrast(seen, self._information.bins, weights)
            worth[part] = self._information.measure(found, pixels, gain)
        return worth


SWAP_FRAME: Final = 120
FRAMES: Final = 180
JUDGED_EVERY: Final = 3
OBSERVED_EVERY: Final = 6
SCENES: Final = (("shelves", 3000), ("hall", 3000))  # `street` 1 and `leaves` 3 were looked at while this was made
STOPS: Final = (4.0, 6.0)
DRIVES: Final = (("uneven", 300), ("uneven", 301), ("low", 300))
DRIVE_FRAMES: Final = 360

NOBODY, ALL, SUN, SHADE, SLOW, LIAR, OLD = (
    "nobody", "tracks everywhere", "cares for the sun", "cares for the shade", "the same, once a second",
    "claims the shade", "cared for the shade",
)  # fmt: skip
"""The left half is in the sun at first; the last one falls silent when sun and shade swap."""


def _consumers() -> dict[str, tuple[Consumer, int]]:
    """Each with how often it reports: every so many frames."""
    return {
        ALL: (Orb(), 2), SUN: (Caring("left"), 2), SHADE: (Caring("right"), 2), SLOW: (Caring("right"), round(RATE_HZ)),
        LIAR: (Liar("right"), 2), OLD: (Caring("right", SWAP_FRAME), 2),
    }  # fmt: skip


def measure_halves(*, scene: str, seed: int, stops: float, frames: int = FRAMES) -> Plain:
    """By consumer: what each part is worth before and after the swap, and points an observer follows in each half."""
    stage, judge = stage_of(scene, seed, stops, SWAP_FRAME / RATE_HZ), HalvesJudge()
    entrants = [Entrant.of(DEFAULT_POLICY)]
    entrants += [Entrant(name, 2, partial(Steered, *each)) for name, each in _consumers().items()]
    start = best_start(Oracle(stage))
    runs = [(entrant.name, entrant.enter(start), Orb()) for entrant in entrants]
    seen: dict[str, list[dict[str, float]]] = {name: [] for name, _, _ in runs}
    for frame in range(frames):
        stage.go_to(frame)
        for name, delayed, observer in runs:
            pair = delayed.step(stage.take)
            counted = observer.track(pair)[1] if frame % OBSERVED_EVERY < 2 else None
            if frame % JUDGED_EVERY == 1 and counted is not None:
                points = {f"{half} points": float(counted[where].sum()) for half, where in HALVES.items()}
                setting = pair.reference.setting
                worth = judge.worth(pair.reference.grey8(), setting)
                seen[name].append({"frame": frame, "level": setting.level, **worth, **points})
    return {NOBODY if name == DEFAULT_POLICY else name: _means(rows) for name, rows in seen.items()}


def _means(rows: list[dict[str, float]]) -> dict[str, Plain]:
    """Means before the swap and after it."""
    before = [row for row in rows if WARM_UP_FRAMES <= row["frame"] < SWAP_FRAME]
    after = [row for row in rows if row["frame"] >= SWAP_FRAME]
    return {
        when: {key: float(np.mean([row[key] for row in part])) for key in part[0] if key != "frame"}
        for when, part in (("before", before), ("after", after))
        if part
    }


def jobs(quick: bool) -> list[Job]:
    """Each scene with each contrast, and the drives; a quick run has one scene until the swap."""
    if quick:
        arguments: dict[str, Plain] = {"scene": "leaves", "seed": 3, "stops": 6.0, "frames": SWAP_FRAME}
        return [Job(measure_halves, arguments, 15.0, (DEFAULT_POLICY,))]
    halves: list[dict[str, Plain]] = [
        {"scene": scene, "seed": seed, "stops": stops} for (scene, seed), stops in product(SCENES, STOPS)
    ]
    drives: list[dict[str, Plain]] = [{"light": light, "room": room, "frames": DRIVE_FRAMES} for light, room in DRIVES]
    return [
        *(Job(measure_halves, case, 40.0, (DEFAULT_POLICY,)) for case in halves),
        *(Job(measure_drive, case, 60.0, (DEFAULT_POLICY,)) for case in drives),
    ]


def section(results: Results, _folder: Path) -> ReportSection:
    """Worth and points beside those without steering."""
    halves = [result for arguments, result in results if "stops" in arguments]
    parts: list[Table | Figure] = []
    for when, title in (("before", "left half in the sun"), ("after", "right half in the sun")):
        known = [result for result in halves if all(when in means for means in result.values())]
        if known:
            parts.append(_table(known, when, title))
    drives = [(arguments, result) for arguments, result in results if "light" in arguments]
    if drives:
        parts.append(_drives(drives))
    return ReportSection(
        text_beside(
            __file__,
            swap_s=SWAP_FRAME / RATE_HZ,
            rate_hz=RATE_HZ,
            latency_frames=LATENCY_FRAMES,
            all=ALL,
            sun=SUN,
            shade=SHADE,
            slow=SLOW,
            liar=LIAR,
            old=OLD,
        ),
        list(_claims(halves)),
        parts,
    )


def ratio(result: Any, name: str, when: str, key: str) -> float:
    """A figure as a multiple of that without steering."""
    return float(result[name][when][key] / max(result[NOBODY][when][key], 1e-9))


def _table(halves: list[Any], when: str, title: str) -> Table:
    rows = []
    for name in halves[0]:
        ratios = [[ratio(result, name, when, part) for result in halves] for part in PARTS]
        points = [np.mean([result[name][when][f"{half} points"] for result in halves]) for half in HALVES]
        lowest = f"{min(ratios[2]):.2f}"
        rows.append([name, *(f"{np.mean(each):.2f}" for each in ratios), lowest, *(f"{each:.0f}" for each in points)])
    heads = ["consumer", *(f"worth: {part}" for part in PARTS), "whole, worst", *(f"points: {half}" for half in HALVES)]
    return Table(f"Beside no steering, {title}; means over {len(halves)} courses.", heads, rows)


def _drives(drives: list[tuple[Any, Any]]) -> Table:
    rows = []
    for arguments, result in drives:
        for name, run in zip(NAMES, result, strict=True):
            course = f"{arguments['light']}, room {arguments['room']}"
            figures = f"{run['rpe_mm']:.2f}", f"{run['lost_share']:.1%}", f"{run['inliers']:.0f}", f"{run['level']:.2f}"
            rows.append([course, name, *figures])
    return Table("Odometry that steers itself.", ["drive", "exposure", "RPE, mm", "lost", "inliers", "level"], rows)


def _claims(halves: list[Any]) -> Iterator[Claim]:
    gain = [ratio(result, *each) for result in halves for each in ((SUN, "before", "left"), (SHADE, "before", "right"))]
    yield Claim.of_this_project(
        "the half that a consumer cares for is worth more when it steers, on average by a fifth, and never less",
        f"{np.mean(gain):.2f} times as much, {min(gain):.2f} at least",
        holds=min(gain) >= 0.98 and float(np.mean(gain)) >= 1.2,
    )
    harm = [ratio(result, name, when, "whole") for result in halves for name in (LIAR, OLD) for when in result[name]]
    limit = 1.0 - STEERING_SHARE - 0.05
    yield Claim.of_this_project(
        f"a consumer that lies, or is silent since the light changed, leaves {limit:g} of the whole picture's worth",
        f"{min(harm):.2f} in the worst course, {np.mean(harm):.2f} on average",
        holds=min(harm) >= limit,
    )
    honest = [ratio(result, ALL, when, "whole") for result in halves for when in result[ALL]]
    yield Claim.of_this_project(
        "a consumer that tracks everywhere writes nothing off: 0.95 of the whole picture's worth remain",
        f"{min(honest):.2f} in the worst course, {np.mean(honest):.2f} on average",
        holds=min(honest) >= 0.95,
    )


# Not in the papers.
EXPERIMENT = Experiment("steering", "Exposure that consumers steer (ours)", jobs, section)
