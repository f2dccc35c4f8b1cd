"""Trains `zhang2024`: an actor, with two critics, that earns Zhang's reward in random episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from autoexpose_daemon.control.policies.learned.policies import LARGEST_STEP_STOPS, Sight, Zhang2024
from autoexpose_daemon.control.policy import Look
from evaluation.training.episode import Episode, TrainingPicture, tuning_pictures
from evaluation.training.training import Arrays, Batch, TrainedNet, net_arrays
from imaging.exposure import ExposureSetting

UNITS = 64
DISCOUNT = 0.9  # Per decision. Theirs is 0.99; here what a frame is worth hardly depends on decisions ten before it.
RATE, LAST_RATE = 1e-3, 1e-4  # Of Adam, at the beginning and at the end of a training
FOLLOWING = 0.01  # How far the slow nets move with each update
SMOOTHING, MOST_SMOOTHING = 0.1, 0.3  # Noise added to actions that targets are computed for
ACTOR_EVERY = 2  # Updates of the critics for each of the actor
BENDING = 1e-3  # What the square of the actor's output before tanh costs: keeps it where tanh still has a slope


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """What was seen, done, earned and seen then: float32, (rows, inputs), (rows, 1), (rows, 1), (rows, inputs)."""

    before: Batch
    actions: Batch
    rewards: Batch
    after: Batch


class ActorCritic:
    """Learns actions -1..1 that earn most. `state`: holds all nets, as `begin` made them."""

    def __init__(self, state: Arrays) -> None:
        self.actor = TrainedNet(state, "actor")
        self._critics = [TrainedNet(state, f"critic{place}") for place in range(2)]
        self.slow_actor = TrainedNet(state, "slow_actor")
        self._slow_critics = [TrainedNet(state, f"slow_critic{place}") for place in range(2)]

    @classmethod
    def begin(cls, state: Arrays, inputs: int, rng: np.random.Generator) -> ActorCritic:
        """New nets in a state."""
        TrainedNet.begin(state, "actor", (inputs, UNITS, UNITS, 1), rng).copy_to("slow_actor")
        for place in range(2):
            critic = TrainedNet.begin(state, f"critic{place}", (inputs + 1, UNITS, UNITS, 1), rng)
            critic.copy_to(f"slow_critic{place}")
        return cls(state)

    def act(self, inputs: Batch) -> Batch:
        """Actions (rows, 1) for inputs (rows, inputs)."""
        return np.tanh(self.actor.forward(inputs))

    def update(self, batch: Transitions, number: int, rate: float, rng: np.random.Generator) -> None:
        """One step of the critics towards what actions earn and, at every other one, of the actor."""
        noise = np.clip(SMOOTHING * rng.standard_normal(batch.actions.shape), -MOST_SMOOTHING, MOST_SMOOTHING)
        later = np.clip(np.tanh(self.slow_actor.forward(batch.after)) + noise.astype(np.float32), -1.0, 1.0)
        promised = [critic.forward(np.hstack([batch.after, later])) for critic in self._slow_critics]
        wanted = np.asarray(batch.rewards + np.float32(DISCOUNT) * np.minimum(*promised), np.float32)
        judged = np.hstack([batch.before, batch.actions])
        rows = np.float32(len(judged))
        for critic, slow in zip(self._critics, self._slow_critics, strict=True):
            gradients, _ = critic.backward((critic.forward(judged) - wanted) / rows)
            critic.descend(gradients, rate)
            slow.follow(critic, FOLLOWING)
        if number % ACTOR_EVERY == 0:
            output = self.actor.forward(batch.before)
            actions = np.tanh(output)
            critic = self._critics[0]
            critic.forward(np.hstack([batch.before, actions]))
            _, slopes = critic.backward(np.full((len(judged), 1), -1.0 / rows, np.float32))
            slopes = slopes[:, -1:] * (1.0 - actions * actions) + np.float32(BENDING) * output / rows
            gradients, _ = self.actor.backward(slopes)
            self.actor.descend(gradients, rate)
            self.slow_actor.follow(self.actor, FOLLOWING)


INPUTS = 130
FLICKER_WEIGHT = 0.2  # Of the change of the mean, as theirs
BATCH = 128
EXPLORING = 0.25  # Standard deviation of what is added to actions, at first; it falls to a fifth
REMEMBERED = 40_000  # Transitions; older ones are forgotten
KEPT = 40  # Inputs that each round keeps for the range of what was learnt


@dataclass(frozen=True)
class TrainingOfZhang:
    """`Training` of `zhang2024`."""

    rounds: int = 80  # each of `episodes` episodes of `frames` frames, then `updates` of the nets
    episodes: int = 24
    frames: int = 100
    updates: int = 600
    pictures: int = 8  # seeds of pictures
    policy_id: str = "zhang2024"

    @cached_property
    def _pictures(self) -> list[TrainingPicture]:
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
    return -math.sqrt(abs(mean - Zhang2024.MEAN_TARGET)) - FLICKER_WEIGHT * math.sqrt(abs(mean - previous))


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
