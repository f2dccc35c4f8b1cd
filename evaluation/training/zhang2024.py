"""Trains `zhang2024`: an actor that earns Zhang's reward in random episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from autoexpose_daemon.control.policies.learned.learned_policy import Sight
from autoexpose_daemon.control.policies.learned.zhang2024 import LARGEST_STEP_STOPS, MEAN_TARGET, Zhang2024
from autoexpose_daemon.control.policy import Look
from evaluation.training.actor_critic import LAST_RATE, RATE, ActorCritic, Transitions
from evaluation.training.backprop import Batch
from evaluation.training.episode import Episode
from evaluation.training.pictures import Picture, tuning_pictures
from evaluation.training.weights_file import Arrays, net_arrays
from imaging.exposure import ExposureSetting

INPUTS = 130

FLICKER_WEIGHT = 0.2
"""Of the change of the mean, as theirs."""

BATCH = 128

EXPLORING = 0.25
"""Standard deviation of what is added to actions, at first; it falls to a fifth."""

REMEMBERED = 40_000
"""Transitions; older ones are forgotten."""

KEPT = 40
"""Inputs that each round keeps for the range of what was learnt."""


@dataclass(frozen=True)
class TrainingOfZhang:
    """`Training` of `zhang2024`.

    Attributes
    ----------
    rounds
        Each of `episodes` episodes of `frames` frames, then `updates` of the nets.
    pictures
        Seeds of pictures.
    """

    rounds: int = 80
    episodes: int = 24
    frames: int = 100
    updates: int = 600
    pictures: int = 8
    policy_id: str = "zhang2024"

    @cached_property
    def _pictures(self) -> list[Picture]:
        return tuning_pictures(self.pictures)

    def begin(self, rng: np.random.Generator) -> Arrays:
        """New nets, and nothing seen."""
        state: Arrays = {
            "before": np.zeros((0, INPUTS), np.float16),
            "after": np.zeros((0, INPUTS), np.float16),
            "earned": np.zeros((0, 2), np.float32),
            "kept": np.zeros((0, INPUTS), np.float32),
        }
        ActorCritic.begin(state, INPUTS, rng)
        return state

    def proceed(self, state: Arrays, number: int, rng: np.random.Generator) -> None:
        """Drive some episodes, then learn from what is remembered."""
        learner = ActorCritic(state)
        done = number / max(self.rounds - 1, 1)
        noise, rate = EXPLORING * (1.0 - 0.8 * done), RATE + (LAST_RATE - RATE) * done
        drives = [_Drive(Episode(self._pictures, rng, self.frames)) for _ in range(self.episodes)]
        for frame in range(self.frames):
            inputs = np.array([drive.see(frame) for drive in drives], np.float32)
            actions = learner.act(inputs)[:, 0] + noise * rng.standard_normal(len(drives))
            if number == 0:
                actions = rng.uniform(-1.0, 1.0, len(drives))
            for drive, action in zip(drives, np.clip(actions, -1.0, 1.0).tolist(), strict=True):
                drive.act(action)
        for drive in drives:
            _remember(state, drive)
        kept = np.concatenate([drive.inputs for drive in drives])
        state["kept"] = np.concatenate([state["kept"], kept[:: max(1, len(kept) // KEPT)]])
        for update in range(self.updates):
            places = rng.integers(len(state["earned"]), size=BATCH)
            earned = state["earned"][places]
            before, after = (state[name][places].astype(np.float32) for name in ("before", "after"))
            learner.update(Transitions(before, earned[:, :1], earned[:, 1:], after), update, rate, rng)

    def finish(self, state: Arrays, seed: int) -> Arrays:
        """The actor, followed slowly: it wavers less than the latest one."""
        return net_arrays(ActorCritic(state).slow_actor.layers, state["kept"], seed)


class _Drive:
    """One episode in closed loop."""

    def __init__(self, episode: Episode) -> None:
        self.episode = episode
        self.settings: list[ExposureSetting] = [episode.start] * episode.delay_frames
        self.sights: list[Sight] = []
        self.seen: list[Batch] = []
        self.actions: list[float] = []
        self.means: list[float] = []

    @property
    def inputs(self) -> Batch:
        """Of the net, for each frame."""
        return np.array(self.seen, np.float32)

    def see(self, frame: int) -> Batch:
        """Take a frame; the inputs of the net."""
        setting = self.settings[frame]
        look = self.episode.look(frame, setting)
        self.means.append(_mean(look))
        self.sights.append(Sight("left", setting.level, Zhang2024.features(look)))
        last = self.sights[-Zhang2024.FRAMES :]
        sights: Sequence[Sight] = [last[0]] * (Zhang2024.FRAMES - len(last)) + last
        self.seen.append(Zhang2024.inputs(sights, setting.gain_db).astype(np.float32))
        return self.seen[-1]

    def act(self, action: float) -> None:
        """Ask for the exposure of a later frame."""
        self.actions.append(action)
        level = self.sights[-1].level + LARGEST_STEP_STOPS * action
        self.settings.append(self.episode.setting(level))

    def rewards(self) -> list[float]:
        """Of each action, from the frame taken with it."""
        delay = self.episode.delay_frames
        return [reward(self.means[at], self.means[at - 1]) for at in range(delay, len(self.means))]


def reward(mean: float, previous: float) -> float:
    """Zhang's, by the mean signals (0..1) of a frame and of the one before it."""
    return -math.sqrt(abs(mean - MEAN_TARGET)) - FLICKER_WEIGHT * math.sqrt(abs(mean - previous))


def _mean(look: Look) -> float:
    black = look.response.black_level
    return (float(look.image.mean()) - black) / (look.response.saturation - black)


def _remember(state: Arrays, drive: _Drive) -> None:
    """Add the transitions of an episode, from each frame to the one taken with its decision; drop the oldest."""
    delay = drive.episode.delay_frames
    inputs, rewards = drive.inputs.astype(np.float16), drive.rewards()
    earned = np.column_stack([drive.actions[: len(rewards)], rewards]).astype(np.float32)
    for name, new in (("before", inputs[:-delay]), ("after", inputs[delay:]), ("earned", earned)):
        state[name] = np.concatenate([state[name], new])[-REMEMBERED:]
