"""What it is worth to be steered by consumers: half a picture in the sun, and a drive by odometry."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from autoexpose_daemon.control.picture.steering import STEERING_SHARE
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import (
    Claim,
    Experiment,
    Figure,
    Job,
    Plain,
    Results,
    Section,
    Table,
    jobs_and_results,
)
from evaluation.experiments.steering.consumers import (
    HALVES,
    LATENCY_FRAMES,
    NAMES,
    PARTS,
    Caring,
    Consumer,
    Judge,
    Liar,
    Orb,
    Steered,
    measure_drive,
    stage_of,
)
from evaluation.scenes.scenarios import RATE_HZ, WARM_UP_FRAMES
from evaluation.stage.delayed_loop import Entrant
from evaluation.stage.oracle import Oracle, best_start

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
        ALL: (Orb(), 2),
        SUN: (Caring("left"), 2),
        SHADE: (Caring("right"), 2),
        SLOW: (Caring("right"), round(RATE_HZ)),
        LIAR: (Liar("right"), 2),
        OLD: (Caring("right", SWAP_FRAME), 2),
    }


def measure_halves(*, scene: str, seed: int, stops: float, frames: int = FRAMES) -> Plain:
    """By consumer: what each part is worth before and after the swap, and points an observer follows in each half."""
    stage, judge = stage_of(scene, seed, stops, SWAP_FRAME / RATE_HZ), Judge()
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


def section(results: Results, _folder: Path) -> Section:
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
    return Section(_SETTING, list(_claims(halves)), parts)


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


_SETTING = f"""\
A painted still sways before both cameras; the left half of each picture is 4 or 6 stops brighter than the right one,
and after {SWAP_FRAME / RATE_HZ:g} s the right one as much brighter than the left one. The default policy runs at
{RATE_HZ:g} Hz with a delay of two frames, steered by one consumer whose reports take {LATENCY_FRAMES} frames. `{ALL}`
follows ORB features from frame to frame; `{SUN}` and `{SHADE}` follow them everywhere and report as inliers only those
of the left and of the right half; `{SLOW}`: on one frame a second; `{LIAR}` claims 20 inliers of 20 features in each
cell of the right half and 0 of 20 in the left, whatever it sees; `{OLD}` is silent after the swap. Worth: Fisher
information of the left camera's frames, as the policy counts it, of a half or the whole, as a multiple of that without
steering. Points: those that ORB follows in each half, by an observer that steers nothing. The drive is fig12's: the
in-house odometry reports its own features and inliers."""

# Not in the papers.
EXPERIMENT = Experiment("steering", "Exposure that consumers steer (ours)", jobs, section, jobs_and_results)
