"""Trains `berthold2013`: ridge regression from random units to the level that reaches the wanted mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from autoexpose_daemon.control.policies.learned.policies import Berthold2013, Sight
from evaluation.arrays import Floats
from evaluation.training.episode import Episode, TrainingPicture, babbled_levels, sights_of, tuning_pictures
from evaluation.training.training import Arrays, net_arrays

UNITS = 200
SPREAD = 0.8  # Standard deviation of what goes into a unit: where tanh begins to bend
# Of an input: figures that hardly change, such as black shares, are not blown up to the size of others.
LEAST_DEVIATION = 0.15
RIDGE = 1e-4  # Per sample: what keeps the read-out small
FRAMES = 60  # Of an episode
# Of a change that is asked for: the read-out is linear, and rare large ones should not pull at all others.
LARGEST_STOPS = 8.0
INPUTS = 147
KEPT = 40  # Inputs that each round keeps for the range of what was learnt


@dataclass(frozen=True)
class TrainingOfBerthold:
    """`Training` of `berthold2013`."""

    rounds: int = 80  # of `episodes` each
    episodes: int = 16
    pictures: int = 8  # seeds of pictures
    policy_id: str = "berthold2013"

    @cached_property
    def _pictures(self) -> list[TrainingPicture]:
        return tuning_pictures(self.pictures)

    def begin(self, rng: np.random.Generator) -> Arrays:
        """Random connections, scaled by the inputs of some episodes; sums of nothing."""
        inputs = np.concatenate([self._samples(rng)[0] for _ in range(self.episodes)])
        centre, deviation = inputs.mean(axis=0), inputs.std(axis=0) + LEAST_DEVIATION
        random = rng.standard_normal((UNITS, INPUTS)) * SPREAD / np.sqrt(INPUTS)
        matrix = random / deviation
        return {
            "matrix": matrix.astype(np.float32),
            "offsets": (rng.uniform(-1.0, 1.0, UNITS) - matrix @ centre).astype(np.float32),
            "squares": np.zeros((UNITS + 1, UNITS + 1)),
            "products": np.zeros(UNITS + 1),
            "samples": np.array(0),
            "kept": np.zeros((0, INPUTS), np.float32),
        }

    def proceed(self, state: Arrays, number: int, rng: np.random.Generator) -> None:
        """Add the samples of one round to the sums."""
        for _ in range(self.episodes):
            inputs, wanted = self._samples(rng)
            units = np.tanh(inputs @ state["matrix"].T.astype(np.float64) + state["offsets"])
            rows = np.column_stack([units, np.ones(len(units))])
            state["squares"] += rows.T @ rows
            state["products"] += rows.T @ wanted
            state["samples"] = state["samples"] + len(rows)
            kept = inputs[:: max(1, len(inputs) * self.episodes // KEPT)].astype(np.float32)
            state["kept"] = np.concatenate([state["kept"], kept])

    def finish(self, state: Arrays, seed: int) -> Arrays:
        """Solve for the read-out."""
        penalty = RIDGE * float(state["samples"]) * np.eye(UNITS + 1)
        penalty[-1, -1] = 0.0
        solved = np.linalg.solve(state["squares"] + penalty, state["products"])
        layers = [(state["matrix"], state["offsets"]), (solved[None, :-1], solved[-1:])]
        return net_arrays(layers, state["kept"], seed)

    def _samples(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Inputs (rows, INPUTS) and wanted changes of level (rows,), stops, of one episode under random exposures."""
        episode = Episode(self._pictures, rng, FRAMES)
        right = [episode.level_of_mean(frame, Berthold2013.MEAN_TARGET) for frame in range(FRAMES)]
        settings = [episode.setting(level) for level in babbled_levels(right, rng)]
        sights: Sequence[Sight] = sights_of(Berthold2013, episode, settings)
        inputs, wanted = [], []
        for frame in range(Berthold2013.FRAMES - 1, FRAMES - episode.delay_frames):
            seen = sights[frame - Berthold2013.FRAMES + 1 : frame + 1]
            inputs.append(Berthold2013.inputs(seen, settings[frame].gain_db))
            change = right[frame + episode.delay_frames] - settings[frame].level
            wanted.append(float(np.clip(change, -LARGEST_STOPS, LARGEST_STOPS)))
        return np.array(inputs), np.array(wanted)
