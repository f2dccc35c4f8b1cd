"""Which courses the arena runs: scenes, seeds and delays, within a time budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from evaluation.committed import HELD_OUT_SEED
from evaluation.scenes.scenarios import SCENARIOS

Split = Literal["tune", "heldout"]

QUICK_SEED = 2000
"""Of quick arenas, which anyone may look at. Seeds 0 to 99 are for tuning; reports had 2000 to 2013."""

MAIN_DELAY = 2
"""The delay (frames) that results are for."""

OTHER_DELAYS = (1, 3)

TUNE_SCENES = ("room", "leaves", "street")

HELD_OUT_SEEDS = {"room": 14, "shelves": 8, "hall": 8}
"""The scenes that judge, with the number of their seeds, from `HELD_OUT_SEED`; `shelves` and `hall` with other seeds
are in `worth-tuning`."""

TUNE_SEEDS = 3
SEEDS_OF_OTHER_DELAYS = 3
"""Seeds per scene in the full arena: about 40 minutes on two cores for 14 policies."""


@dataclass(frozen=True, slots=True)
class Task:
    """One course, which all policies run side by side with each of the delays."""

    scenario: str
    scene: str
    seed: int
    delays: tuple[int, ...]
    split: Split
    keep_traces: bool = False

    @property
    def frames(self) -> int:
        """Frames of the course."""
        return SCENARIOS[self.scenario].frames


def full_plan(scenarios: Sequence[str], pictures: Sequence[str] = ()) -> list[Task]:
    """Every scenario in many scenes; `pictures` are .hdr files added to the held-out scenes, with one seed each."""
    tasks = []
    for scenario in scenarios:
        for scene, seeds in HELD_OUT_SEEDS.items():
            for index in range(seeds):
                delays = (MAIN_DELAY, *OTHER_DELAYS) if index < SEEDS_OF_OTHER_DELAYS else (MAIN_DELAY,)
                trace = scene == "room" and index == 0
                tasks.append(Task(scenario, scene, HELD_OUT_SEED + index, delays, "heldout", trace))
        tasks += [Task(scenario, picture, HELD_OUT_SEED, (MAIN_DELAY,), "heldout") for picture in pictures]
        tasks += [
            Task(scenario, scene, seed, (MAIN_DELAY,), "tune") for scene in TUNE_SCENES for seed in range(TUNE_SEEDS)
        ]
    return sorted(tasks, key=lambda task: -task.frames * len(task.delays))


def quick_plan(scenarios: Sequence[str], pictures: Sequence[str] = ()) -> list[Task]:
    """Every scenario once, cycling through the held-out scenes."""
    scenes = (*HELD_OUT_SEEDS, *pictures)
    tasks = [
        Task(scenario, scenes[index % len(scenes)], QUICK_SEED, (MAIN_DELAY,), "heldout", keep_traces=True)
        for index, scenario in enumerate(scenarios)
    ]
    return sorted(tasks, key=lambda task: -task.frames)
