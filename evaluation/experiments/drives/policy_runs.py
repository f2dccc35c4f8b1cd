"""What the runs of fig12 gave, by scene and policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from evaluation.experiments.drives.courses import over_rooms
from evaluation.experiments.experiment import Results
from evaluation.experiments.statistics import Interval
from evaluation.odometry.lap import Light
from fake_camera.world.sensor import DEFAULT_F_NUMBER

Run = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Scene:
    """A light, and the cameras' lenses."""

    title: str
    light: Light
    lens_f_number: float = DEFAULT_F_NUMBER


UNEVEN = Scene("(a) 1 to 217 lux", "uneven")
LOW = Scene("(b) 2 to 4 lux", "low")
LOW_SCENES = (LOW, Scene("(b) half a lux", "faint"), Scene("(b) 2 to 4 lux, f/2.8", "low", 2.8))
SCENES = (UNEVEN, *LOW_SCENES)


class PolicyRuns:
    """Results of jobs: each policy of a scene has driven through the same rooms.

    Attributes
    ----------
    policies
        In the order of their first runs.
    room
        The first one.
    """

    def __init__(self, results: Results) -> None:
        self._runs: dict[tuple[Any, Any], dict[str, list[Run]]] = {}
        for case, runs in results:
            of_scene = self._runs.setdefault((case["light"], case["lens_f_number"]), {})
            policies: Any = case["policies"]
            for policy, run in zip(policies, runs, strict=True):
                of_scene.setdefault(policy, []).append(run)
        self.policies = list(dict.fromkeys(policy for of_scene in self._runs.values() for policy in of_scene))
        self.room: Any = results[0][0]["room"]

    def of(self, scene: Scene, policy: str) -> list[Run]:
        """All runs of a policy, in the order of their jobs: one for each room."""
        return self._runs.get((scene.light, scene.lens_f_number), {}).get(policy, [])

    def rooms(self, scene: Scene) -> int:
        """How many rooms were driven through."""
        return len(self.of(scene, self.policies[0]))

    def difference(self, scene: Scene, first: str, second: str, figure: Callable[[Run], float]) -> Interval:
        """First minus second, paired by room."""
        pairs = zip(self.of(scene, first), self.of(scene, second), strict=True)
        return over_rooms(np.array([figure(a) - figure(b) for a, b in pairs]))

    def failed(self, scene: Scene, policy: str) -> int:
        """How many runs failed."""
        return sum(run["failed"] for run in self.of(scene, policy))


def error(run: Run) -> float:
    """Of odometry, mm."""
    return float(run["rpe_mm"])


def metric(run: Run) -> float:
    """Median gradient information of the frames that odometry gets."""
    return float(run["metric_after_gamma"])


def level(run: Run) -> float:
    """Mean exposure level, stops."""
    return float(np.mean(np.log2(run["times_us"]) + np.array(run["gains_db"]) / (20 * np.log10(2))))
