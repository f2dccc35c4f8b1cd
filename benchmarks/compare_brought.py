"""Whether views register better with a map once they are brought to the map's exposure, on a lap of a simulated park.

The robot stands exactly at the taught places, so every shift is an error. Brought: the linear camera's grey levels are
scaled by the difference of the exposure levels before features are found.

Run with `.venv/bin/python benchmarks/compare_brought.py [--seed N] [--every N]`.
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.navigation.laps import LIGHTS, Taught, taught
from evaluation.experiments.navigation.seasons import ParkScene
from evaluation.experiments.teach.park import ParkPath
from evaluation.experiments.teach.replay import ExposingRobot
from evaluation.stage.camera import Entrant, SimulatedCamera
from navigation.views.features import FINDERS, AdaptiveFinder
from navigation.views.registration import register

POLICIES = (DEFAULT_POLICY, "majer2018-standard")
CORRECT_PX = 5.0
SETTLE_FRAMES = 6
"""At each place, until the exposure is that of the place."""


def brought(image: NDArray[np.uint8], stops: float) -> NDArray[np.uint8]:
    """What a linear camera without a black level would have seen with so many stops more."""
    return np.clip(np.rint(np.arange(256) * 2.0**stops), 0, 255).astype(np.uint8)[image]


def compare(lesson: Taught, light: str, every: int) -> str:
    """Shares of views that register within `CORRECT_PX`, and median votes, as they are and brought."""
    scene, camera = ParkScene(lesson.seed, LIGHTS[light]), SimulatedCamera(2 * lesson.seed + 1, 2 * lesson.seed + 1)
    finders: list[AdaptiveFinder] = [FINDERS["fast-orb"](), FINDERS["fast-orb"]()]
    robot: ExposingRobot | None = None
    errors_px: list[list[float]] = []
    votes: list[list[int]] = []
    for place in lesson.places[::every]:
        progress = min(place.distance_m / lesson.path.length_m, 1.0)
        radiance = scene.radiance(lesson.path.seen_from(*lesson.path.ground(place.distance_m)), progress)
        robot = robot or ExposingRobot(camera, radiance, [Entrant.of(lesson.policy)])
        for _ in range(SETTLE_FRAMES):
            image = robot.step(radiance)[lesson.policy]
        stops = place.setting.level - robot.loops[lesson.policy].settings[-1].level
        views = [finder.find(each) for finder, each in zip(finders, (image, brought(image, stops)), strict=True)]
        found = [register(place.map.features, view).vote for view in views]
        errors_px.append([np.inf if vote.shift_px is None else abs(vote.shift_px) for vote in found])
        votes.append([vote.votes for vote in found])
    shares, medians = np.mean(np.array(errors_px) < CORRECT_PX, axis=0), np.median(votes, axis=0)
    return f"{shares[0]:10.2f} {shares[1]:8.2f} {medians[0]:10.0f} {medians[1]:8.0f}"


def main() -> None:
    """Print a line for each light and policy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=46, help="of the park")
    parser.add_argument("--every", type=int, default=5, help="of so many taught places one is looked at")
    options = parser.parse_args()
    print(f"{'':34} within 5 px  brought      votes  brought")
    path = ParkPath(options.seed, 0.0)
    lessons = {policy: taught(path, options.seed, policy, path.length_m) for policy in POLICIES}
    for (policy, lesson), light in product(lessons.items(), LIGHTS):
        print(f"{policy:19} {light:14} {compare(lesson, light, options.every)}", flush=True)


if __name__ == "__main__":
    main()
